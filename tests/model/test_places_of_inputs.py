"""A run names its index, logs and first weights, wherever they are."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from model import train
from model.runs.provenance import index_of, init_of, sessions_of
from model.runs.run_folder import weights_checksum
from tests.helpers.driving import one_line_of, run, untrained_run
from tests.helpers.toy import SMALL, toy_index

pytestmark = pytest.mark.usefixtures("project")


def run_that_names(project: Path, index: str, **values: object) -> Path:
    made = untrained_run(project / "runs" / "theirs")
    config = json.loads((made / "config.json").read_text())
    data = {"logs": {"toy": {"log": "../toy.mcap", "fingerprint": "0" * 64}}}
    (made / "config.json").write_text(json.dumps({**config, "index": index, "data": data, **values}))
    return made


def test_a_copied_run_in_its_project_needs_no_flags(project: Path) -> None:
    toy_index(project)
    made = run_that_names(project, "../../index")
    assert index_of(made) == Path("index")
    assert sessions_of(made) == Path()


def test_an_index_in_a_store_is_to_be_brought_first(project: Path) -> None:
    made = run_that_names(project, "s3://lab/index")
    refused = run("bc-eval", made, cwd=project)
    assert refused.returncode == 1
    assert "`bc-copy s3://lab/index index`, and give --index index" in one_line_of(refused)


def test_initial_weights_that_are_gone_are_found_by_name_in_runs(project: Path) -> None:
    ours = untrained_run(project / "runs" / "first")
    init = {"run": "first", "place": "../../../gone/first", "weights_sha256": weights_checksum(ours)}
    first = init_of(run_that_names(project, "../../index", init=init), project / "runs")
    assert first is not None
    assert first.resolve() == ours


def test_a_run_of_an_index_elsewhere_is_measured_and_repeated(project: Path) -> None:
    index = toy_index(project.parent / "far")
    train(index, project / "runs" / "ours", SMALL)
    done = run("bc-eval", "ours", cwd=project)
    assert "measured on the frames" in done.stdout, done.stderr
    assert sessions_of(project / "runs" / "ours") == index.parent
    theirs = shutil.copytree(project / "runs" / "ours", project.parent / "far" / "runs" / "theirs")
    done = run("bc-train", "--like", theirs, "--name", "again", cwd=project)
    assert (done.returncode, (project / "runs" / "again").is_dir()) == (0, True), done.stderr


def test_only_the_current_folder_gets_the_index_that_is_built_for_a_run(project: Path) -> None:
    """A run from elsewhere may name any folder."""
    index = toy_index(project.parent / "far")
    train(index, project / "runs" / "ours", SMALL)
    (index / "samples.parquet").write_bytes(b"of another index")
    before = sorted(path.name for path in index.parent.iterdir())
    done = run("bc-train", "--like", "ours", "--name", "again", cwd=project)
    assert done.returncode == 0, done.stderr
    assert (project / "index-ours" / "samples.parquet").is_file()
    assert sorted(path.name for path in index.parent.iterdir()) == before
