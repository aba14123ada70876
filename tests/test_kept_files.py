"""Files that earlier versions have written are read by this one: tests/data has some of each version."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from common.versions import VERSION
from dataset import DatasetError, Samples, build_index, decode, load
from dataset.frames.frames_file import FRAMES_FORMAT
from dataset.samples.samples_format import READABLE_FORMATS, SAMPLES_FORMAT
from model import load_pilot
from model.runs.checkpoint import FORMAT as CHECKPOINT_FORMAT
from model.runs.run_files import DRIVABLE
from model.runs.run_files import FORMAT as RUN_FORMAT
from model.runs.run_summary import summarize_run
from recorder import Log
from recorder.upkeep.check import check
from tests.helpers.kept_files import DATA, ROWS
from tests.helpers.repository import ROOT

VERSIONS = sorted(path.name for path in DATA.iterdir())
WITH_DIVIDED = [version for version in VERSIONS if (DATA / version / "divided").is_dir()]
WITH_RUN = [version for version in VERSIONS if (DATA / version / "run").is_dir()]


def expected(version: str) -> dict[str, Any]:
    stored: dict[str, Any] = json.loads((DATA / version / "expected.json").read_text(encoding="utf-8"))
    return stored


def test_this_version_has_files_and_all_of_them_are_small() -> None:
    assert VERSION in WITH_RUN, "python -m tests.helpers.kept_files"
    assert sum(path.stat().st_size for path in DATA.rglob("*") if path.is_file()) <= 2_000_000


@pytest.mark.parametrize("version", VERSIONS)
def test_logs_have_their_rows_and_pictures(version: str) -> None:
    reported, path = expected(version), DATA / version / "toy.mcap"
    with Log(path) as log:
        assert log.metadata["toolkit"] == version
        assert log.vehicle()["steering"].to_pylist() == reported["steering"]
        assert [hashlib.sha256(log.picture(row)).hexdigest() for row in ROWS] == reported["pictures"]
    assert not check(path).findings


@pytest.mark.parametrize("version", VERSIONS)
def test_indexes_are_learnt_from_as_they_are_and_built_anew(version: str, tmp_path: Path) -> None:
    reported, folder = expected(version), DATA / version
    with Samples(folder / "index") as samples:
        assert samples.fingerprint == reported["fingerprint"]
        np.testing.assert_allclose(samples.table["label"], reported["labels"], atol=1e-6)
    with load(folder / "index", batch=8) as loader:
        assert next(loader.epoch(1)).pictures.shape == (8, 128, 128, 3)
    copy = shutil.copytree(folder, tmp_path / version)
    build_index([copy / "toy.mcap"], copy / "index")
    with Samples(copy / "index") as samples:
        assert samples.metadata["format"] == SAMPLES_FORMAT


@pytest.mark.parametrize("version", WITH_DIVIDED)
def test_indexes_of_several_sample_files_are_refused_and_built_anew(version: str, tmp_path: Path) -> None:
    copy = shutil.copytree(DATA / version, tmp_path / version)
    with pytest.raises(DatasetError, match=r"samples\.parquet: has format 6, not 5; run `bc-index` again"):
        Samples(copy / "divided")
    build_index([copy / "toy.mcap"], copy / "divided")
    with Samples(copy / "divided") as samples:
        assert samples.metadata["format"] == SAMPLES_FORMAT
        assert len(samples.table)


@pytest.mark.parametrize("version", WITH_RUN)
def test_runs_steer_as_they_did(version: str) -> None:
    folder = DATA / version
    pilot = load_pilot(folder / "run", "float32")
    with Log(folder / "toy.mcap") as log:
        predicted = [pilot.predict(pilot.crop(decode(log.picture(row)))) for row in ROWS]
    np.testing.assert_allclose(predicted, expected(version)["predicted"], atol=1e-4)
    assert summarize_run(folder / "run").problem == ""


def test_the_page_about_upgrading_has_todays_formats() -> None:
    page = (ROOT / "docs" / "upgrading.md").read_text(encoding="utf-8")
    rows = {
        cells[0]: cells[1:]
        for line in page.splitlines()
        if line.startswith("|") and len(cells := [cell.strip() for cell in line.strip("|").split("|")]) == 4
    }
    series = re.sub(r"\.\d+$", "", VERSION)
    assert rows["what"][1] == f"{series} writes"
    assert rows["`index/samples.parquet`"][1:] == [str(SAMPLES_FORMAT), listed(READABLE_FORMATS)]
    assert rows["`index/frames/`"][1] == str(FRAMES_FORMAT)
    assert rows["a run's `config.json`"][1:] == [str(RUN_FORMAT), listed(DRIVABLE)]
    assert rows["a run's checkpoint, `last/`"][1] == CHECKPOINT_FORMAT


def listed(formats: tuple[int, ...]) -> str:
    return ", ".join(map(str, formats))
