"""A run names its index, logs and first weights; those of somebody else's run are opened in its project only."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from common.location import Url
from dataset import Samples
from driving import one_line_of, run, untrained_run
from model import train
from model.errors import RunError
from model.runs.run_folder import weights_checksum
from model.runs.run_inputs import allowed_index_of, init_of, sessions_of
from toy import SMALL, toy_index

pytestmark = pytest.mark.usefixtures("project")


def run_that_names(project: Path, index: str, **values: object) -> Path:
    made = untrained_run(project / "runs" / "theirs")
    config = json.loads((made / "config.json").read_text())
    data = {"logs": {"toy": {"log": "../toy.mcap", "fingerprint": "0" * 64}}}
    (made / "config.json").write_text(json.dumps({**config, "index": index, "data": data, **values}))
    return made


def test_a_copied_run_opens_no_index_outside_of_its_project(project: Path) -> None:
    toy_index(project.parent / "private")
    made = run_that_names(project, "../../../private/index")
    with pytest.raises(RunError, match=r"as its index, which is not in its project.* --index ") as error:
        allowed_index_of(made)
    assert "\n" not in str(error.value)
    assert sessions_of(made) is None


def test_measuring_a_copied_run_asks_for_the_index(project: Path) -> None:
    private = toy_index(project.parent / "private")
    made = run_that_names(project, "../../../private/index")
    refused = run("bc-eval", made, cwd=project)
    assert refused.returncode != 0
    assert one_line_of(refused).endswith(f"--index {private}")


def test_a_copied_run_in_its_project_needs_no_flags(project: Path) -> None:
    toy_index(project)
    made = run_that_names(project, "../../index")
    assert allowed_index_of(made) == Path("index")
    assert sessions_of(made) == Path()


def test_an_index_in_a_store_is_to_be_brought_first(project: Path) -> None:
    made = run_that_names(project, "s3://lab/index")
    refused = run("bc-eval", made, cwd=project)
    assert refused.returncode == 1
    assert "`bc-copy s3://lab/index index`, and give --index index" in one_line_of(refused)


def test_an_index_that_is_gone_is_nobodys(project: Path) -> None:
    assert allowed_index_of(run_that_names(project, "../../../gone/index")) is None


def test_initial_weights_outside_the_project_are_found_by_name_in_runs(project: Path) -> None:
    private = untrained_run(project.parent / "private" / "first")
    ours = shutil.copytree(private, project / "runs" / "first")
    init = {"run": "first", "place": "../../../private/first", "weights_sha256": weights_checksum(private)}
    made = run_that_names(project, "../../index", init=init)
    first = init_of(made, project / "runs")
    assert first is not None
    assert first.resolve() == ours
    away = {**init, "place": str(Url("s3", "private", "first"))}
    assert init_of(run_that_names(project.parent / "second", "../../index", init=away), project / "runs") == first


def test_a_run_that_was_trained_here_on_an_index_elsewhere_is_measured(project: Path) -> None:
    index = toy_index(project.parent / "far")
    train(index, project / "runs" / "ours", SMALL)
    done = run("bc-eval", "ours", cwd=project)  # another process
    assert "measured on the frames" in done.stdout, done.stderr
    with Samples(index) as samples:
        assert list(samples.logs) == ["toy"]
    assert sessions_of(project / "runs" / "ours") == index.parent
    theirs = shutil.copytree(project / "runs" / "ours", project.parent / "other" / "runs" / "theirs")
    refused = run("bc-train", "--like", theirs, cwd=project)
    assert refused.returncode != 0
    assert one_line_of(refused).endswith(f"--index {index}")
