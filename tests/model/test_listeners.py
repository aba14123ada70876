"""Listeners: code of one's own that is told of a training, shown with MLflow; none of them can end it."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from model.cli import main
from tests.helpers.driving import one_line_in
from tests.helpers.repository import ROOT
from tests.helpers.udacity import call

LISTENER = """
import json
from pathlib import Path

class Notes:
    def __init__(self, run, config):
        self.file = Path(__file__).with_name("notes.jsonl").open("w")
        self.note({"run": run.name, "epochs": config.epochs})

    def note(self, values):
        print(json.dumps(values), file=self.file, flush=True)

    def step(self, step):
        self.note(step.scalars)

    def epoch(self, epoch):
        self.note(epoch.scalars)

    def close(self):
        self.file.close()

class Broken(Notes):
    def epoch(self, epoch):
        raise ConnectionError("no such server")

def nothing(run, config):
    return config

def fails(run, config):
    raise ValueError("no key")
"""


@pytest.fixture
def flags(index: Path, tmp_path: Path) -> tuple[object, ...]:
    """Those of a short training, and a file with listeners, whose class is to follow."""
    (tmp_path / "mine.py").write_text(LISTENER)
    settings = ("--network", "small", "--epochs", 2, "--batch", 4, "--recipe", "original", "--threads", 1)
    return ("--name", "first", "--index", index, "--runs", tmp_path / "runs", *settings, "--listener")


def lines(path: Path) -> list[dict[str, float]]:
    return [json.loads(line) for line in path.read_text().splitlines()]


def test_code_that_is_named_is_reported_of_every_step_and_epoch(flags: tuple[object, ...], tmp_path: Path) -> None:
    assert call(main, *flags, f"{tmp_path / 'mine.py'}:Notes") == 0
    first, *output = lines(tmp_path / "notes.jsonl")
    assert first == {"run": "first", "epochs": 2}
    epochs = lines(tmp_path / "runs" / "first" / "metrics.jsonl")
    assert [point["loss/validation"] for point in output if "epoch" in point] == [
        e["validation_loss"] for e in epochs
    ]
    steps = lines(tmp_path / "runs" / "first" / "steps.jsonl")
    assert [point["loss/steps"] for point in output if "loss/steps" in point] == [
        e["training_loss"] for e in steps
    ]


def test_one_that_fails_is_said_and_the_training_goes_on(
    flags: tuple[object, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call(main, *flags, f"{tmp_path / 'mine.py'}:Broken") == 3
    printed = "Broken receives nothing more of this training: ConnectionError: no such server"
    assert printed in capsys.readouterr().err
    assert len(lines(tmp_path / "runs" / "first" / "metrics.jsonl")) == 2
    assert (tmp_path / "runs" / "first" / "model.safetensors").exists()


@pytest.mark.parametrize(
    ("name", "printed"),
    [
        ("nothing", "expected a listener with step, epoch and close; it has no step"),
        ("fails", r"mine.py:fails fails (ValueError: no key)"),
        ("Note", "did you mean Notes?"),
    ],
)
def test_what_is_no_listener_is_one_line_before_anything_is_trained(
    flags: tuple[object, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str], name: str, printed: str
) -> None:
    assert call(main, *flags, f"{tmp_path / 'mine.py'}:{name}") == 1
    assert printed in one_line_in(capsys)
    assert not (tmp_path / "runs").exists()


@pytest.mark.needs("mlflow")
def test_mlflow_has_the_settings_and_every_point(
    flags: tuple[object, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MLFLOW_ALLOW_FILE_STORE", "true")  # plain files, without a database
    monkeypatch.setenv("MLFLOW_TRACKING_URI", (tmp_path / "mlruns").as_uri())
    assert call(main, *flags, f"{ROOT / 'examples' / 'mlflow_listener.py'}:MlflowListener") == 0
    import mlflow

    client = mlflow.MlflowClient()
    experiment = client.get_experiment_by_name("driving")
    assert experiment is not None
    (run,) = client.search_runs([experiment.experiment_id])
    assert run.info.run_name == "first"
    assert run.info.status == "FINISHED"
    assert (run.data.params["epochs"], run.data.params["network"]) == ("2", "small")
    epochs = lines(tmp_path / "runs" / "first" / "metrics.jsonl")
    history = client.get_metric_history(run.info.run_id, "loss/validation")
    assert [point.value for point in history] == [epoch["validation_loss"] for epoch in epochs]
    steps = lines(tmp_path / "runs" / "first" / "steps.jsonl")
    kept = client.get_metric_history(run.info.run_id, "loss/steps")
    assert [(point.step, point.value) for point in kept] == [(e["samples"], e["training_loss"]) for e in steps]
