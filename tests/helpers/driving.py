"""What the tests of driving share: road pictures, an untrained network, and `bc-drive` as a real process."""

from __future__ import annotations

import functools
import importlib
import io
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Sequence
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import replace
from pathlib import Path
from typing import Final, Self

import cv2
import numpy as np
import pytest
import torch

from dataset.prediction_targets import STEERING_ONLY, TARGETS, TargetName
from model.network.choice import built_in
from model.runs.run_folder import create_run, save_weights
from tests.helpers.repository import ROOT
from tests.helpers.udacity import call, encode
from tests.helpers.waiting import PATIENCE_S as PATIENCE_S

COMMANDS: Final = {
    "bc-record": "recorder.cli",
    "bc-import": "recorder.import_cli",
    "bc-log": "recorder.log_cli",
    "bc-copy": "drive.copy_cli",
    "bc-index": "dataset.cli",
    "bc-train": "model.cli",
    "bc-runs": "model.runs_cli",
    "bc-drive": "drive.cli",
    "bc-play": "viz.cli",
    "bc-sim": "simulator.cli",
    "bc-eval": "drive.evaluation.eval_cli",
    "bc-demo": "drive.demo",
    "bc-doctor": "drive.doctor_cli",
    "bc-web": "web.cli",
}
"""The module of each command's `main`."""


def command(name: str, *arguments: object) -> list[str]:
    """A `bc-` command line that runs without being installed."""
    code = f"from behavioural_cloning_toolkit import {name.replace('-', '_')} as main; main()"
    return [sys.executable, "-c", code, *map(str, arguments)]


PATIENT: Final = (
    f"import drive.drive_session as it; it.WATCHDOG_S = it.SILENT_S = {PATIENCE_S}",
    f"import recorder.teleop.pedals as it; it.stopping_s = lambda speed_mph: {PATIENCE_S}",
    f"import recorder.server.telemetry_server as it; it.FIRST_COMMAND_S = {PATIENCE_S}",
)
"""Python for `command_after`: what serves a simulator sends it nothing unasked, though others keep it from telling
for a second, as happens where many tests run."""


def command_after(code: Sequence[str], name: str, *arguments: object) -> list[str]:
    """The same, when these lines of Python have run."""
    python, flag, line, *rest = command(name, *arguments)
    return [python, flag, "; ".join([*code, line]), *rest]


def with_viewer(code: str) -> str:
    """Python for `command_after` by which this code takes the place of the viewer."""
    return f"import common.preview; common.preview.VIEWER = ('-c', {code!r})"


def environment() -> dict[str, str]:
    """The sources on the path, one thread a process, and a width at which no message is wrapped."""
    root = str(ROOT)
    return {**os.environ, "PYTHONPATH": root, "OMP_NUM_THREADS": "1", "COLUMNS": "400", "NO_COLOR": "1"}


def run(name: str, *arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command in this process; its exit code and output."""
    main = importlib.import_module(COMMANDS[name]).main
    stdout, stderr = (io.TextIOWrapper(io.BytesIO(), "utf-8", newline="", write_through=True) for _ in range(2))
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(stdout), redirect_stderr(stderr):
        patch.setenv("COLUMNS", "400")
        patch.setenv("NO_COLOR", "1")
        if cwd is not None:
            patch.chdir(cwd)
        code = call(main, *arguments)
    texts = (stream.buffer.getvalue().decode() for stream in (stdout, stderr))
    return subprocess.CompletedProcess([name, *map(str, arguments)], code, *texts)


def run_alone(name: str, *arguments: object, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run a command in a process of its own, for what a process has only once, such as a connection to Ray."""
    return subprocess.run(
        command(name, *arguments), cwd=cwd, env=environment(), capture_output=True, text=True, check=False
    )


def run_code(code: str, *flags: str, cwd: Path | None = None) -> subprocess.CompletedProcess[str]:
    """Run Python code, with our sources on its path, to its end; `flags` are the interpreter's."""
    line = [sys.executable, *flags, "-c", code]
    return subprocess.run(
        line, cwd=cwd, env=environment(), capture_output=True, text=True, timeout=PATIENCE_S, check=False
    )


def one_line_of(done: subprocess.CompletedProcess[str]) -> str:
    """The only line on stderr: an error that a user sees has no traceback, and nothing is on stdout."""
    return _only_line(done.stdout, done.stderr)


def one_line_in(capsys: pytest.CaptureFixture[str]) -> str:
    """The same of a command that ran in this process (`udacity.call`), which costs no seconds of imports."""
    return _only_line(*capsys.readouterr())


def _only_line(stdout: str, stderr: str) -> str:
    lines = stderr.splitlines()
    assert len(lines) == 1, stderr
    assert stdout == ""
    return lines[0]


@functools.cache
def road_jpeg(number: int) -> bytes:
    """A drawn road, 320x160, that bends with `number`; every number gives another picture."""
    picture = np.zeros((160, 320, 3), np.uint8)
    picture[:60] = (200, 160, 120)
    picture[60:] = (60, 110, 70)
    far = 160 + 60 * np.sin(number / 5)
    road = np.array([(40, 159), (280, 159), (far + 12, 60), (far - 12, 60)], np.int32)
    cv2.fillPoly(picture, [road], (90, 90, 90))
    cv2.circle(picture, (number * 37 % 320, 70 + number * 11 % 60), 8, (30, 200, 250), -1)
    return encode(picture)


def untrained_run(
    folder: Path, seed: int = 0, targets: Sequence[TargetName] = STEERING_ONLY, network: str = "small"
) -> Path:
    """A run whose network was never trained, but steers differently for every picture. Of the speed, it always
    says 10 mph: else the car might stand still."""
    torch.manual_seed(seed)
    choice = replace(built_in(network, {"standardized": True}), outputs=len(targets))
    made = choice.build()
    for parameter in made.parameters():
        if parameter.dim() > 1:
            torch.nn.init.kaiming_uniform_(parameter, nonlinearity="relu")
    if "speed" in targets:
        *_, weight, bias = made.parameters()
        with torch.no_grad():
            weight[targets.index("speed")], bias[targets.index("speed")] = 0, 10 / TARGETS["speed"].per_unit
    config = {"seed": seed, "targets": targets, "network": choice.description}
    create_run(folder, config, choice.picture)
    save_weights(folder, made.state_dict(), epoch=0)
    return folder


class Process:
    """A command that runs on; its stderr is read as it comes. It is killed with the context, if it still runs."""

    def __init__(self, line: Sequence[str], cwd: Path | None = None) -> None:
        pipe = subprocess.PIPE
        self.popen = subprocess.Popen(line, cwd=cwd, env=environment(), stdout=pipe, stderr=pipe, text=True)
        self.stderr: list[str] = []
        self.stdout = ""
        self._said = threading.Condition()
        self._ended = False
        self._threads = [threading.Thread(target=self._read_stderr), threading.Thread(target=self._read_stdout)]
        for thread in self._threads:
            thread.start()

    def wait_for(self, pattern: str) -> re.Match[str]:
        """The first line of stderr that matches; an AssertionError with all of it, if none does."""

        def found() -> re.Match[str] | None:
            return next((match for line in self.stderr if (match := re.search(pattern, line))), None)

        with self._said:
            self._said.wait_for(lambda: found() or self._ended, PATIENCE_S)
            match = found()
            assert match is not None, f"no {pattern!r} in {self.stderr}"
            return match

    def end(self, number: signal.Signals = signal.SIGINT) -> int:
        """Send a signal and wait for the end; the exit code."""
        self.popen.send_signal(number)
        return self.join()

    def join(self) -> int:
        code = self.popen.wait(PATIENCE_S)
        for thread in self._threads:
            thread.join(PATIENCE_S)
        return code

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        if self.popen.poll() is None:
            self.popen.kill()
        self.join()
        for stream in (self.popen.stdout, self.popen.stderr):
            if stream is not None:
                stream.close()

    def _read_stderr(self) -> None:
        assert self.popen.stderr is not None
        for line in self.popen.stderr:
            with self._said:
                self.stderr.append(line.rstrip("\n"))
                self._said.notify_all()
        with self._said:
            self._ended = True
            self._said.notify_all()

    def _read_stdout(self) -> None:
        assert self.popen.stdout is not None
        for line in self.popen.stdout:
            self.stdout += line


class DriveProcess(Process):
    """`bc-drive` on a free port, with the run and the log given, and no window.

    It is `PATIENT`, unless it shall be seen how it `minds_silence`. `viewer`: Python code in the place of its
    viewer."""

    def __init__(
        self, run_folder: Path, log: Path, *flags: object, minds_silence: bool = False, viewer: str = ""
    ) -> None:
        self.log = log
        hidden = () if "--viewer" in flags else ("--viewer", "off")
        arguments = (run_folder, "--log", log, "--port", 0, *hidden, *flags)
        before = [*(() if minds_silence else PATIENT), *([with_viewer(viewer)] if viewer else [])]
        super().__init__(command_after(before, "bc-drive", *arguments))

    def wait_until_it_listens(self) -> int:
        """Its port."""
        return int(self.wait_for(r"is waiting for a simulator on 127\.0\.0\.1:(\d+)")[1])
