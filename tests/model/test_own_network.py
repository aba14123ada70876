"""`--network FILE.py:CLASS`: anybody's own network, whose code runs only because its user has named it."""

from __future__ import annotations

import hashlib
import json
import shlex
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from dataset import decode, load
from dataset.picture_spec import ORIGINAL
from drive.evaluation.eval_cli import main as bc_eval
from model import RunError, export_onnx, load_pilot, train
from model.cli import main
from model.evaluation.predict import as_input
from model.network.choice import choose_network
from model.network.own_code import load_code
from model.network.visual_backprop import visual_backprop
from model.runs.run_folder import load_answer_scale, load_network
from tests.helpers.driving import road_jpeg, untrained_run
from tests.helpers.needs import require
from tests.helpers.toy import TINY
from tests.helpers.udacity import call

ONE = replace(TINY, epochs=1, batch=8)

PLAIN = """
import pathlib
from torch import nn
pathlib.Path(__file__ + ".has-run").touch()  # {}

class Net(nn.Module):
    def __init__(self, planes=4):
        super().__init__()
        self.see = nn.Sequential(nn.Conv2d(3, planes, 5, 4, padding="valid"), nn.BatchNorm2d(planes), nn.ReLU())
        self.act = nn.Linear(planes, 1)

    def forward(self, x):
        assert -1 <= x.min() and x.max() <= 1
        return self.act(self.see(x).mean((2, 3)))
"""

ODD = """
import torch
from torch import nn

class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.act = nn.Linear(3, 1)

    def forward(self, x):
        x = (x * torch.linspace(-4, 4, x.shape[3]).to(x)).mean((2, 3))  # where the road is, from left to right
        return torch.tanh(self.act(x if x.sum() > 0 else x * 2))[:, 0]
"""


def written(folder: Path, source: str, name: str = "net.py") -> Path:
    """A file of code that no other test has: what was named once may be loaded in this process."""
    path = folder / name
    path.write_text(f"{source}\n# {folder}\n")
    return path


def trained(index: Path, folder: Path, source: str = PLAIN, **changed: Any) -> tuple[Path, Path]:
    """The code's file, and a run of it."""
    path = written(folder, source)
    settings = replace(ONE, network=f"{path}:Net", **changed)
    return path, train(index, folder / "runs" / "mine", settings).run


def by_a_stranger(run: Path) -> None:
    """Make it a run whose code nobody has named in this process."""
    copy, config = run / "network.py", json.loads((run / "config.json").read_text())
    copy.write_text(copy.read_text().replace("class Net", "class Stranger"))
    config["network"] |= {
        "name": "net.py:Stranger",
        "file_sha256": hashlib.sha256(copy.read_bytes()).hexdigest(),
    }
    config["training"]["network"] = "net.py:Stranger"
    (run / "config.json").write_text(json.dumps(config))


def test_it_trains_and_the_run_keeps_its_file_and_its_arguments(index: Path, tmp_path: Path) -> None:
    path, run = trained(index, tmp_path, network_args=("planes=6",), answers="natural", average_steps=3)
    config = json.loads((run / "config.json").read_text())
    assert (run / "network.py").read_bytes() == path.read_bytes()
    assert config["network"] == {
        "name": "net.py:Net",
        "arguments": {"planes": 6},
        "file_sha256": hashlib.sha256(path.read_bytes()).hexdigest(),
    }
    more = replace(ONE, epochs=2, network=f"{run / 'network.py'}:Net", answers="natural", average_steps=3)
    more = replace(more, network_args=("planes=6",))
    again = train(index, run, more, resume=True)
    assert len(again.epochs) == 1
    pilot = load_pilot(run, "float32")
    crop = pilot.crop(decode(road_jpeg(4)))
    with torch.inference_mode():
        expected = load_network(run)(as_input(crop[None])).item()
    assert pilot.predict(crop) == pytest.approx(expected, abs=1e-5)
    assert load_pilot(run, "bfloat16").predict(crop) == pytest.approx(expected, abs=0.02)


def test_nobodys_code_runs_because_a_run_names_it(
    index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, run = trained(index, tmp_path)
    by_a_stranger(run)
    (has_run := Path(f"{path}.has-run")).unlink()
    flag = f"--network {run / 'network.py'}:Stranger"
    refused = rf"mine: its network is net\.py:Stranger, code that runs only if you name it: {flag}"
    lines: list[tuple[Callable[[], None], list[str]]] = [
        (main, ["resume", "mine"]),
        (main, ["--like", "mine", "--name", "other"]),
        (main, ["export", "mine", "--onnx"]),
        (bc_eval, ["mine"]),
    ]
    for command, arguments in lines:
        assert call(command, *arguments, "--runs", run.parent) == 1
        (output,) = capsys.readouterr().err.splitlines()
        assert flag in output
        assert "runs only if you name it" in output
    with pytest.raises(RunError, match=refused):
        load_pilot(run)
    assert not has_run.exists()
    assert not Path(f"{run / 'network.py'}.has-run").exists()
    assert call(main, "resume", "mine", "--runs", run.parent, "--epochs", 2, *flag.split()) == 0
    assert "mine: net.py:Stranger, " in capsys.readouterr().out
    assert load_pilot(run)  # it was named by now


def test_commands_to_paste_name_the_network(
    index: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    _, run = trained(index, tmp_path)
    flag = ["--network", f"{run / 'network.py'}:Net"]
    assert call(main, "resume", "mine", "--runs", run.parent, "--epochs", 2, *flag) == 0
    printed = capsys.readouterr().out.splitlines()
    for line, begin in zip(printed[-3::2], ("drive with `bc-drive", "next: `bc-"), strict=True):
        _, command = line.split(begin, 1)
        assert shlex.split(command.split("`")[0])[1:].count("--network") == 1, line
        assert " ".join(flag) in command


def test_a_module_that_a_run_names_is_not_imported(tmp_path: Path) -> None:
    run = untrained_run(tmp_path / "run")
    config = json.loads((run / "config.json").read_text())
    for name in ("this:Net", "os:system"):
        (run / "config.json").write_text(json.dumps({**config, "network": {"name": name, "arguments": {"x": 1}}}))
        with pytest.raises(RunError, match=rf"its network is {name}, code .* name it: --network {name}$"):
            load_pilot(run)
    assert "this" not in sys.modules
    (run / "config.json").write_text(json.dumps({**config, "network": {"name": "../x:y"}}))
    with pytest.raises(RunError, match="its network is unknown"):
        load_pilot(run)


def test_a_file_that_has_changed_since_is_reported(index: Path, tmp_path: Path) -> None:
    path, run = trained(index, tmp_path)
    config = json.loads((run / "config.json").read_text())
    config["network"]["file_sha256"] = "0" * 64
    (run / "config.json").write_text(json.dumps(config))
    path.write_text(path.read_text() + "# better\n")
    load_code(f"{path}:Net")
    with pytest.raises(RunError, match=r"Net: not the file that .*mine was trained with .* give --network .*Net"):
        load_pilot(run)


def test_what_its_layers_cannot_do_is_said(index: Path, tmp_path: Path) -> None:
    """No ReLU, and a way that depends on what it sees; it drives all the same, and answers naturally."""
    path = written(tmp_path, ODD)
    settings = replace(ONE, network=f"{path}:Net", answers="natural")
    done = train(index, tmp_path / "runs" / "mine", settings)
    assert load_answer_scale(done.run).scale != 1.0
    picture = decode(road_jpeg(1))
    pilots = [load_pilot(done.run, "float32"), load_pilot(done.run, "bfloat16")]
    output = [pilot.predict(pilot.crop(picture)) for pilot in pilots]
    assert output[0] == pytest.approx(output[1], abs=0.02)
    with pytest.raises(RunError, match=r"no nn\.ReLU after a convolution"):
        visual_backprop(load_network(done.run), as_input(pilots[0].crop(picture)[None]))
    with pytest.raises(
        RunError, match="cannot be written as ONNX: its path through the layers depends on the picture"
    ):
        export_onnx(done.run, tmp_path / "mine.onnx")


BODY = """
import torch
from torch import nn

class Net(nn.Module):
    def __init__(self):
        super().__init__()
        self.one = nn.Linear(3, 1)
        {made}

    def forward(self, x):
        {answer}
"""


def body(made: str = "pass", answer: str = "return self.one(x.mean((2, 3)))") -> str:
    return BODY.format(made=made, answer=answer)


@pytest.mark.parametrize(
    ("source", "output"),
    [
        ("import nothing_of_the_kind", r"net\.py cannot be run \(ModuleNotFoundError"),
        ("class Net(", r"net\.py cannot be run \(SyntaxError"),
        ("raise SystemExit(3)", r"net\.py cannot be run \(SystemExit: 3\)"),
        ("class Nett: pass", r"no Net in .*net\.py; did you mean Nett\?"),
        ("class Net: pass", r"returns a Net, expected a torch\.nn\.Module"),
        (body("raise ValueError('no\\nluck')"), r"net\.py:Net\(\) fails \(ValueError: no\)"),
        (body("self.one.cuda()"), "it needs a GPU, and PyTorch finds none"),
        (body(answer="return self.one(x.mean((2, 3)).cuda())"), "it needs a GPU, and PyTorch finds none"),
        (
            body(answer="return x.mean((2, 3))"),
            r"answers \(2, 3\) of torch\.float32 to 2 pictures: expected one number",
        ),
        (body(answer="return x.mean()"), r"answers \(\) of torch\.float32 to 2 pictures"),
        (body(answer="return {'steering': x}"), "answers dict to 2 pictures: expected one number for each"),
        (
            body(answer="return self.one(x.mean((2, 3))) / 0 * 0"),
            r"net\.py:Net gives an answer that is not finite",
        ),
        (body("self.one = nn.Linear(7, 1)"), r"cannot take pictures of 128 x 128 px \(RuntimeError"),
        (body("self.two = self.one"), r"network\.one\.weight and network\.two\.weight share their weights"),
        (body("self.one = nn.Identity()"), "has no parameters"),
        (body("self.one = nn.LazyLinear(1)"), r"network\.one\.weight has no size yet"),
    ],
)
def test_what_cannot_be_trained_is_one_line(tmp_path: Path, source: str, output: str) -> None:
    if "GPU" in output:
        require("no_gpu")
    path = written(tmp_path, source)
    with pytest.raises(RunError, match=output) as caught:
        choose_network(replace(ONE, network=f"{path}:Net")).try_out(ORIGINAL, torch.device("cpu"))
    assert "\n" not in str(caught.value)


def test_what_is_not_there_is_reported_with_what_was_meant(cwd: Path) -> None:
    with pytest.raises(RunError, match=r"--network no\.such\.module:Net: .* cannot be imported"):
        load_code("no.such.module:Net")
    with pytest.raises(RunError, match=r"cannot be read .* give FILE\.py:CLASS, the file by its path"):
        load_code("my_net.py:Net")
    (cwd / "my_nets.py").write_text(PLAIN)
    with pytest.raises(RunError, match=r"did you mean my_nets\.py\?"):
        load_code("my_net.py:Net")


# A single sample

NORMALISED = body("self.two = nn.BatchNorm1d(3)", "return self.one(self.two(x.mean((2, 3))))")


@pytest.mark.parametrize("micro_batch", [0, 2])
def test_batch_normalisation_survives_a_last_batch_of_one(index: Path, tmp_path: Path, micro_batch: int) -> None:
    """The sample is left out of this epoch; a last micro-batch of one joins the one before it."""
    with load(index, batch=3) as loader:
        samples = len(loader)
    batch = next(batch for batch in range(3, samples) if samples % batch == 1)
    network = f"{written(tmp_path, NORMALISED)}:Net"
    done = train(index, tmp_path / "run", replace(ONE, network=network, batch=batch, micro_batch=micro_batch))
    assert len((done.run / "metrics.jsonl").read_text().splitlines()) == 1
