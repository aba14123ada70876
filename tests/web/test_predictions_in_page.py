"""The steering that a run's network predicts, over what was recorded: its curve, its worst moments, its errors."""

from __future__ import annotations

import contextlib
import json
import math
import os
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import psutil  # type: ignore[import-untyped]
import pytest
import torch

from model.network.choice import built_in
from model.runs.run_folder import create_run, save_weights
from recorder import LogWriter
from tests.helpers.logs import write_log
from tests.helpers.pages import open_session, opened_page
from tests.helpers.toy import STEERING, road
from tests.helpers.waiting import wait_until
from tests.helpers.workbench import Served, served
from web.processes.kept_work import KeptWork

if TYPE_CHECKING:
    from playwright.sync_api import Browser

ANSWER = 0.26  # of a network with no weights but its last bias, whatever it sees
ROWS = len(STEERING)


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """Sessions, runs and the log of a drive."""
    folder = tmp_path_factory.mktemp("predictions")
    (folder / "sessions").mkdir()
    write_log(folder / "drives" / "toy.mcap", STEERING, road, cameras=["center"])
    write_log(folder / "sessions" / "toy.mcap", STEERING, road, cameras=["center"])
    write_log(folder / "sessions" / "tub.mcap", STEERING, road, cameras=["center"], source="donkeycar")
    write_log(folder / "sessions" / "blind.mcap", STEERING[:5], cameras=[])
    constant_run(folder / "runs" / "constant")
    constant_run(folder / "runs" / "another", 0.5)
    with pytest.MonkeyPatch.context() as patched:
        (folder / "temporary").mkdir()
        patched.setattr(tempfile, "tempdir", str(folder / "temporary"))
        with served(folder) as server:
            yield server


def constant_run(folder: Path, first_layers: float = 0) -> None:
    """A run that answers the same to every picture; its convolutions have weights of `first_layers` all over."""
    choice = built_in("small", {})
    network = choice.build()
    with torch.no_grad():
        for weights in network.parameters():
            weights.fill_(first_layers if weights.dim() == 4 else 0.0)
        list(network.parameters())[-1].fill_(ANSWER)
    create_run(folder, {"network": choice.description}, choice.picture)
    save_weights(folder, network.state_dict(), 1)


@pytest.fixture
def hold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], None]:
    """Once called, what predicts does not begin: a prediction lasts as long as a test looks at it."""

    def begin() -> None:
        (tmp_path / "sitecustomize.py").write_text("import time\ntime.sleep(1000)\n")
        monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)

    return begin


def changed_config(folder: Path, **changed: Any) -> None:
    config = folder / "config.json"
    config.write_text(json.dumps({**json.loads(config.read_text()), **changed}))


def test_the_page_shows_the_prediction_and_its_worst_moments_first(
    browser: Browser, bench: Served, hold: Callable[[], None]
) -> None:
    errors_deg = 25 * (ANSWER - np.array(STEERING))
    worst = int(np.argmax(np.abs(errors_deg)))
    rmse_deg = math.sqrt(np.mean(errors_deg**2))
    mean_rmse_deg = 25 * np.std(STEERING)
    with opened_page(browser, f"{bench.address}/drives/toy") as page:
        open_session(page)
        page.select_option("#run", "constant")
        page.wait_for_selector("#session[data-run=constant]")
        reported = page.inner_text("#predicted")
        assert f"{ROWS} frames, RMSE {rmse_deg:.2f}°; always predicting the mean: {mean_rmse_deg:.2f}°" in reported
        first = page.locator("#worst li").first.inner_text()
        assert f"{abs(errors_deg[worst]):.1f}° too far right" in first
        assert f"row {worst}," in first
        page.keyboard.press("w")
        wait_until(lambda: page.get_attribute("#curves", "aria-valuenow") == str(worst))
        assert "predicted 6.5°" in page.inner_text("#now")
        assert page.locator("#curves .key .predicted").count() == 1
        page.keyboard.press("a")  # where it looks at the picture of this row
        page.wait_for_selector(f"figure[data-attention*='/constant/{worst}?'] .attention")
        page.keyboard.press("a")
        page.wait_for_selector(".attention", state="detached")
        # kept: a page that names the run has it at once, and the project's own folders have nothing new
        page.goto(f"{bench.address}/drives/toy#run=constant")
        page.reload()
        page.wait_for_selector("#session[data-run=constant]")
        hold()
        page.select_option("#run", "another")
        page.click("#predict-stop")
        wait_until(lambda: "stopped" in page.inner_text("#status"))
        assert page.input_value("#run") == ""
        assert page.locator("#predict-stop").is_hidden()
    wait_until(lambda: predicting() == [])
    assert [path.name for path in (bench.folder / "drives").iterdir()] == ["toy.mcap"]
    wait_until(lambda: not list((bench.folder / "temporary").iterdir()))  # also of the one that was killed
    assert len(list((bench.folder / "cache").rglob("predictions/*.npz"))) == 1


def predicting() -> list[str]:
    """The runs whose predictions processes of this one are making."""
    runs = []
    for process in psutil.Process().children():
        with contextlib.suppress(psutil.Error):  # it ends at this moment
            runs += [Path(word).name for word in process.cmdline() if Path(word).parent.name == "runs"]
    return runs


def test_a_prediction_is_stopped_also_one_that_waits(bench: Served, hold: Callable[[], None]) -> None:
    hold()
    for name in ("first", "second"):
        constant_run(bench.folder / "runs" / name, 0.1 if name == "first" else 0.2)
    shown = bench.get("/sessions/toy/state").json["fingerprint"]

    def reported(run: str) -> Any:
        return bench.get(f"/sessions/toy/predictions/{run}?log={shown}").json

    def ask(run: str) -> None:
        assert bench.ask("POST", f"/sessions/toy/predictions/{run}?log={shown}").status in (200, 204)

    ask("first")
    ask("second")
    wait_until(lambda: predicting() == ["first"])
    assert reported("second")["is_begun"] is False
    for run in ("second", "first"):
        ask(f"{run}/stop")
        assert "stopped; choose the run again" in reported(run)["problem"]
    wait_until(lambda: predicting() == [])
    assert reported("first")["about"] is None
    ask("second")  # begins anew
    assert reported("second")["problem"] == ""
    ask("second/stop")
    ask("constant/stop")  # nothing is under way


def test_where_a_network_looks_lies_over_what_it_sees(bench: Served) -> None:
    """One whose layers answer brightness looks at the white post, wherever that is."""
    run = bench.folder / "runs" / "bright"
    constant_run(run, first_layers=0.01)
    for row in (4, 14):  # one to the right, one to the left
        answer = bench.get(f"/sessions/toy/attention/bright/{row}")
        assert answer.headers["content-type"] == "image/png"
        shown = cv2.imdecode(np.frombuffer(answer.body, np.uint8), cv2.IMREAD_UNCHANGED)
        assert shown is not None
        assert shown.shape == (160, 320, 4)
        alpha = shown[..., 3].astype(float)
        assert alpha[:50].min() == alpha[140:].max() > 100  # dark: cut off before the network sees it
        assert not shown[:50, :, :3].any()
        looks = alpha[50:140].sum(0)
        assert np.average(np.arange(320), weights=looks) == pytest.approx(160 + 140 * STEERING[row], abs=15)
    blank = bench.get("/sessions/toy/attention/constant/4").body  # nothing stands out for it
    shown = cv2.imdecode(np.frombuffer(blank, np.uint8), cv2.IMREAD_UNCHANGED)
    assert shown is not None
    assert not shown[50:140, :, 3].any()
    assert bench.get("/sessions/toy/attention/constant/99").status == 404
    assert bench.get("/sessions/toy/attention/none/4").status == 404


def test_what_cannot_be_predicted_reports_why(bench: Served) -> None:
    runs = bench.folder / "runs"
    constant_run(runs / "later")
    changed_config(runs / "later", format=99)
    ran = bench.folder / "ran"
    constant_run(runs / "own")
    (runs / "own" / "network.py").write_text(f"open({str(ran)!r}, 'w')\n")
    changed_config(runs / "own", network={"name": "mine.py:Net", "arguments": {}, "file_sha256": "0" * 64})
    constant_run(runs / "young")
    (runs / "young" / "model.safetensors").unlink()

    def problem(run: str, log: str = "toy", fingerprint: str = "") -> str:
        shown = fingerprint or bench.get(f"/sessions/{log}/state").json["fingerprint"]
        answer = bench.ask("POST", f"/sessions/{log}/predictions/{run}?log={shown}")
        return str(answer.json.get("problem") or answer.json["error"])

    assert "of format 99" in problem("later")
    own = problem("own")
    assert "your own code" in own
    assert "--network" in own
    assert "your own code" in bench.get("/sessions/toy/attention/own/4").json["error"]
    assert not ran.exists()
    assert "weights after its first epoch" in problem("young")
    assert "no picture of the centre camera" in problem("constant", "blind")
    assert "no run 'none'" in problem("none")
    with LogWriter(bench.folder / "sessions" / "now.mcap", {"source": "test"}) as writer:
        writer.picture("center", 0, 0, road("center", 0))
        part = next((bench.folder / "sessions").glob("now.mcap.*.part"))
        assert "this log is being recorded" in problem("constant", part.name, "0" * 64)
    (bench.folder / "sessions" / "now.mcap").unlink()
    assert "the log has changed" in problem("constant", fingerprint="0" * 64)
    assert bench.get("/sessions/toy/predictions/rows/..%2f..%2fx").status == 404
    assert bench.ask("POST", "/sessions/toy/predictions/constant", b"", Sec_Fetch_Site="cross-site").status == 403


def test_of_a_car_whose_angle_is_unknown_it_shows_shares_of_full_lock(browser: Browser, bench: Served) -> None:
    rmse = 100 * math.sqrt(np.mean((ANSWER - np.array(STEERING)) ** 2))
    with opened_page(browser, f"{bench.address}/sessions/tub") as page:
        open_session(page)
        page.select_option("#run", "constant")
        page.wait_for_selector("#session[data-run=constant]")
        assert f"RMSE {rmse:.2f} % of full lock; always" in page.inner_text("#predicted")
        assert "% of full lock too far right" in page.locator("#worst li").first.inner_text()


def test_a_bug_in_the_process_is_reported(tmp_path: Path) -> None:
    work = KeptWork(tmp_path / "cache", "web.processes.no_such_module", "stopped")
    work.start("key", 1, [])
    requested = work.requested("key")
    assert requested is not None
    wait_until(lambda: requested.is_done)
    work.close()
    assert requested.problem == "the process ended with exit code 1; try again"
