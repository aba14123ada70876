"""`bc-train export RUN --hub FOLDER`: a run that others can load, with a card that says what it can do."""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from ruamel.yaml import YAML

from dataset import decode
from model import RunError, load_pilot, train
from model.cli import main
from model.hub_export import export_to_hub
from model.runs.run_files import keep_result
from model.runs.run_folder import create_run, save_weights
from tests.helpers.disk import files_of_at_most
from tests.helpers.driving import road_jpeg, run_code, untrained_run
from tests.helpers.toy import SMALL, toy_index
from tests.helpers.udacity import call

pytestmark = pytest.mark.usefixtures("exported_once")

OURS = ["common", "simulator", "recorder", "dataset", "model", "viz", "drive", "behavioural_cloning_toolkit"]
DRIVE = {"distance_m": 2000.0, "autonomy_percent": 98.7, "mean_offset": 0.1, "max_offset": 0.9, "laps": 2.0}
NETWORK = """
import pathlib
from torch import nn
pathlib.Path(__file__).with_name("has-run").touch()

class Net(nn.Module):
    def __init__(self, planes=4):
        super().__init__()
        self.see = nn.Sequential(nn.Conv2d(3, planes, 5, 4), nn.ReLU(), nn.{pool}, nn.Flatten())
        self.act = nn.Linear(49 * planes, 1)

    def forward(self, pictures):
        return self.act(self.see(pictures))
"""


@pytest.fixture(scope="module")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return toy_index(tmp_path_factory.mktemp("secret"))


@pytest.fixture(scope="module")
def trained(index: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = train(index, tmp_path_factory.mktemp("runs") / "first", SMALL).run
    for track, interventions in (("lake", 0), ("mountain", 3)):
        result = {**DRIVE, "track": track, "set_speed_mph": 10.0, "interventions": interventions}
        keep_result(run, "simulator", {**result, "log": "secret/drives/a.mcap"})
    return run


@pytest.fixture(scope="module")
def exported(trained: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    return export_to_hub(trained, tmp_path_factory.mktemp("hub") / "first", licence="cc-by-4.0").folder


def front_matter(folder: Path) -> dict[str, Any]:
    before, yaml, _ = (folder / "README.md").read_text(encoding="utf-8").split("---\n", 2)
    assert before == ""
    content: dict[str, Any] = YAML(typ="safe").load(yaml)
    return content


def section(folder: Path, title: str) -> str:
    text = (folder / "README.md").read_text(encoding="utf-8")
    return text.partition(f"## {title}\n")[2].partition("\n## ")[0]


def snippets(folder: Path) -> list[str]:
    return re.findall(r"```python\n(.*?)```", section(folder, "How to load it"), re.DOTALL)


def printed(code: str, folder: Path) -> float:
    done = run_code(code, cwd=folder)
    assert done.returncode == 0, done.stderr
    return float(done.stdout)


def test_the_folder_has_what_others_need(trained: Path, exported: Path) -> None:
    names = ["README.md", "config.json", "model.onnx", "model.safetensors"]
    assert sorted(path.name for path in exported.iterdir()) == names
    assert (exported / "model.safetensors").read_bytes() == (trained / "model.safetensors").read_bytes()


def test_it_loads_by_its_card_with_the_toolkit_and_without(trained: Path, exported: Path, tmp_path: Path) -> None:
    elsewhere = shutil.copytree(exported, tmp_path / "downloaded")
    jpeg = road_jpeg(3)
    (elsewhere / "picture.jpg").write_bytes(jpeg)
    pilot = load_pilot(trained, "float32")
    expected = pilot.predict(pilot.crop(decode(jpeg)))
    with_it, without = snippets(elsewhere)
    assert max(code.count("\n") for code in (with_it, without)) <= 10
    assert printed(with_it, elsewhere) == pytest.approx(expected, abs=0.02)  # it may calculate in bfloat16
    hidden = f"import sys; sys.modules.update(dict.fromkeys({['torch', *OURS]}))\n"
    assert printed(hidden + without, elsewhere) == pytest.approx(expected, abs=1e-5)


def test_the_hub_is_reported_licence_tags_and_measures(trained: Path, exported: Path) -> None:
    content = front_matter(exported)
    last = [json.loads(line) for line in (trained / "metrics.jsonl").read_text().splitlines()]
    best = next(epoch for epoch in reversed(last) if epoch["is_best"])
    assert content["license"] == "cc-by-4.0"
    assert {"imitation-learning", "self-driving", "onnx"} <= set(content["tags"])
    (results,) = content["model-index"][0]["results"]
    values = {metric["name"]: metric["value"] for metric in results["metrics"]}
    assert values["RMSE of the steering in degrees"] == pytest.approx(best["validation"]["rmse_deg"], abs=1e-4)
    assert set(values) == {  # all of this network: that of always predicting the mean is in the text
        "RMSE of the steering in degrees",
        "balanced RMSE of the steering in degrees",
        "MAE of the steering in degrees",
    }


def test_the_hubs_own_reader_takes_the_card(exported: Path) -> None:
    from huggingface_hub import ModelCard  # slow

    data = ModelCard.load(exported / "README.md").data
    assert (data.license, data.library_name) == ("cc-by-4.0", "behavioural-cloning-toolkit")
    assert {result.metric_type for result in data.eval_results} == {"rmse", "mae"}


def test_the_card_reports_if_it_has_learnt_nothing(trained: Path, exported: Path, tmp_path: Path) -> None:
    no_better = "**No better than always predicting the mean.**"
    assert no_better not in section(exported, "How well")
    run = shutil.copytree(trained, tmp_path / "first")
    lines = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    for line in lines:
        line["validation"]["rmse_deg"] = line["mean"]["rmse_deg"]
    (run / "metrics.jsonl").write_text("".join(f"{json.dumps(line)}\n" for line in lines))
    assert no_better in section(export_to_hub(run, tmp_path / "hub").folder, "How well")


def test_the_card_reports_where_it_drives_and_where_not(exported: Path) -> None:
    reported = section(exported, "Where it drives, and where not")
    assert "- Without an intervention: lake (2.00 laps at 10 mph).\n" in reported
    assert "- Not without an intervention: mountain (2.00 laps at 10 mph).\n" in reported
    assert "| mountain (2.00 laps at 10 mph) | 2.00 | 3 | 98.7 % |" in reported


def test_of_a_run_that_reports_nothing_the_card_says_so(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = untrained_run(tmp_path / "runs" / "first")
    shutil.copy(trained / "model.safetensors", run)  # whose export is made already
    assert call(main, "export", run, "--hub", tmp_path / "hub") == 0
    output, reported = capsys.readouterr().err, (tmp_path / "hub" / "README.md").read_text()
    assert "bc-eval" in output
    assert output.splitlines()[-1].startswith(f"next: `hf upload first {tmp_path / 'hub'}`")
    assert "--license" in output
    assert "Not stated: ask its author" in reported
    assert "Its errors are unknown" in reported
    assert "It has not driven yet" in reported
    assert "model-index" not in front_matter(tmp_path / "hub")


def test_text_of_others_is_no_markup(trained: Path, tmp_path: Path) -> None:
    run = shutil.copytree(trained, tmp_path / "a|b")
    config = json.loads((run / "config.json").read_text())
    name, log = next(iter(config["data"]["logs"].items()))
    config["data"]["logs"] = {"<script>\n|": log, "[x](y)": {}, name: {"fingerprint": "`"}}
    (run / "config.json").write_text(json.dumps(config))
    folder = export_to_hub(run, tmp_path / "hub", licence="x: [y]").folder
    shown = section(folder, "What it learnt from")
    assert r"| \<script\>\\n\| |" in shown
    assert r"| \[x\](y) |" in shown
    assert front_matter(folder)["license"] == "x: [y]"


def test_nothing_is_overwritten_and_nothing_is_left_half(
    trained: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "mine").mkdir()
    assert call(main, "export", trained, "--hub", tmp_path / "mine") == 1
    assert "mine exists already" in capsys.readouterr().err
    with files_of_at_most(100_000), pytest.raises(RunError, match=r"hub: cannot be written .*; make room"):
        export_to_hub(trained, tmp_path / "new" / "hub")
    assert list(tmp_path.rglob("*")) == [tmp_path / "mine"]


def test_code_of_ones_own_goes_along_as_a_file(index: Path, tmp_path: Path) -> None:
    source = tmp_path / "net.py"
    source.write_text(NETWORK.replace("{pool}", "MaxPool2d(4)"))
    settings = replace(SMALL, epochs=1, batch=40, network=f"{source}:Net", network_args=("planes=3",))
    run = train(index, tmp_path / "runs" / "mine", settings).run
    folder = export_to_hub(run, tmp_path / "hub").folder
    assert (folder / "network.py").read_bytes() == source.read_bytes()
    assert 'load_code("network.py:Net")  # this runs somebody\'s code: read it first' in snippets(folder)[0]
    assert str(tmp_path) not in (folder / "config.json").read_text()


def test_code_that_nobody_names_is_not_run(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "theirs"
    code = NETWORK.replace("{pool}", "MaxPool2d(3)").encode()
    network = {"name": "net.py:Theirs", "arguments": {}, "file_sha256": hashlib.sha256(code).hexdigest()}
    create_run(run, {"network": network}, network_file=code)
    save_weights(run, {}, epoch=0)
    assert call(main, "export", run, "--hub", tmp_path / "hub") == 1
    assert "code that runs only if you name it: --network" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == [run]
    assert not (run / "has-run").exists()


def test_a_network_that_onnx_cannot_hold_goes_without(
    index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = tmp_path / "net.py"
    code = NETWORK.replace("{pool}", "AvgPool2d(4)")
    source.write_text(code.replace("self.see(pictures)", "self.see(pictures).i0()"))
    settings = replace(SMALL, epochs=1, batch=40, network=f"{source}:Net")
    run = train(index, tmp_path / "runs" / "mine", settings).run
    assert call(main, "export", run, "--network", f"{source}:Net", "--hub", tmp_path / "hub") == 3
    output = "hub: without an ONNX file: its network cannot be written as ONNX: ONNX lacks a part of it"
    assert output in capsys.readouterr().err
    assert not (tmp_path / "hub" / "model.onnx").exists()
    assert len(snippets(tmp_path / "hub")) == 1


@pytest.mark.parametrize(
    ("flags", "output"),
    [
        ((), "give one of --onnx for a file, "),
        (("--onnx", "a", "b"), "--onnx: expected [FILE]"),
        (("--onnx", "--hub", "a"), "--hub FOLDER"),
        (("--onnx", "--license", "mit"), "--license is only"),
        (("--hub", "a", "--force"), "--force is only"),
    ],
)
def test_flags_of_an_export_that_do_not_go_together(
    trained: Path, capsys: pytest.CaptureFixture[str], flags: tuple[str, ...], output: str
) -> None:
    assert call(main, "export", trained, *flags) == 2
    assert output in capsys.readouterr().err
