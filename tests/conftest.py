"""What all tests share: where real recordings are, and how skipped tests and properties behave."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sysconfig
from collections import Counter
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Final

import pytest
from hypothesis import settings

from tests.helpers.chromium import chromium
from tests.helpers.needs import RECORDINGS, require
from tests.helpers.places import Place, as_bucket, url_within

if TYPE_CHECKING:
    from playwright.sync_api import Browser

    from tests.helpers.bucket import Bucket

# No test depends on a clock, and random inputs are the same every time.
settings.register_profile("tests", deadline=None, derandomize=True, database=None, max_examples=20)
settings.register_profile("long", settings.get_profile("tests"), max_examples=1000)
settings.load_profile("tests")

# Several test processes share the processors.
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Messages name a command without its folder if the shell would find it.
os.environ["PATH"] = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", os.defpath)])


_FOLDERS: Final = ("web", "drive", "tests", "model", "viz", "common", "simulator", "recorder", "dataset")
"""Those with long tests first, so that no process waits for another one at the end."""


def pytest_configure(config: pytest.Config) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):  # tests open no windows
        os.environ.pop(name, None)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # as a shell starts jobs in the background
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)  # before those of other marks are left out
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    place = {folder: number for number, folder in enumerate(_FOLDERS)}
    items.sort(key=lambda item: place.get(item.path.parent.name, 0))


def pytest_collection_finish() -> None:
    gc.freeze()  # else each garbage collection looks through PyTorch again


def pytest_runtest_setup(item: pytest.Item) -> None:
    for mark in item.iter_markers("needs"):
        require(mark.args[0])


@pytest.hookimpl(trylast=True)
def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """Say last which tests were skipped and why."""
    skipped = terminalreporter.stats.get("skipped", [])
    reasons = Counter(report.longrepr[2].removeprefix("Skipped: ") for report in skipped)
    for reason, count in reasons.most_common():
        terminalreporter.write_line(f"skipped {count}: {reason}")


def pytest_xdist_auto_num_workers() -> int:
    """Half as many again as there are processors: many tests wait for a process, a socket or a clock."""
    processors = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
    return processors + processors // 2


@pytest.fixture(scope="session")
def recordings() -> Path:
    """The folder of real recordings."""
    require("recordings")
    return RECORDINGS


@pytest.fixture(scope="session")
def _browsers() -> Iterator[Callable[[], Browser]]:
    with contextlib.ExitStack() as until_done:
        started: list[Browser] = []

        def running() -> Browser:
            if not started or not started[-1].is_connected():
                until_done.close()
                started.append(until_done.enter_context(chromium()))
            return started[-1]

        yield running


@pytest.fixture
def browser(_browsers: Callable[[], Browser]) -> Browser:
    """Chromium, started once for all tests, and again after it has crashed."""
    return _browsers()


@pytest.fixture
def cwd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which the test works."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which the test works, with an empty cache."""
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    (tmp_path / "project").mkdir()
    monkeypatch.chdir(tmp_path / "project")
    return tmp_path / "project"


@pytest.fixture(scope="session")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The index of toy.py's road, next to its log. Tests only read it."""
    from tests.helpers.toy import toy_index  # PyTorch

    return toy_index(tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="session")
def trained(index: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of one epoch on that index, named `first`, alone in its folder. Tests only read it."""
    from model import train  # PyTorch
    from tests.helpers.toy import ONE

    return train(index, tmp_path_factory.mktemp("runs") / "first", ONE, show_progress=False).run


@pytest.fixture(scope="module")
def exported_once() -> Iterator[None]:
    """Each network is exported to ONNX once for all tests of a file: an export takes seconds."""
    from tests.helpers.exports import export_once  # onnx

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("model.onnx_export._exported", export_once)
        yield


@pytest.fixture(scope="session")
def bucket_of_tests(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, str]]:
    """An S3 server whose bucket is the folder of all temporary files; the environment that leads there."""
    with as_bucket(tmp_path_factory.getbasetemp()) as environment:
        yield environment


@pytest.fixture(params=["disk", "bucket"])
def place(
    request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch
) -> Place:
    """How a command names a file that the test has made: by its path, and by its URL in a bucket."""
    if request.param == "disk":
        return lambda path: path
    for name, value in request.getfixturevalue("bucket_of_tests").items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("BC_CACHE", str(tmp_path_factory.mktemp("cache")))
    return url_within(tmp_path_factory.getbasetemp())


@pytest.fixture
def bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bucket]:
    """An empty bucket, with an empty working folder and an empty cache."""
    from tests.helpers.bucket import serving_bucket  # obstore

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    with serving_bucket(tmp_path / "server", monkeypatch) as served:
        yield served
