"""What all tests share: where real recordings are, and how skipped tests and properties behave."""

from __future__ import annotations

import contextlib
import gc
import os
import signal
import sys
import sysconfig
from collections import Counter
from collections.abc import Callable, Generator, Iterator
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

# No test depends on a clock; and the same examples every time: a failure that comes and goes helps nobody.
settings.register_profile("tests", deadline=None, derandomize=True, database=None, max_examples=20)
settings.register_profile("long", settings.get_profile("tests"), max_examples=1000)
settings.load_profile("tests")

# Several test processes share the processors; what they start has one thread, too (driving.environment).
os.environ.setdefault("OMP_NUM_THREADS", "1")

# Messages name commands as they can be typed: here by their names alone, also where they are not installed.
os.environ["PATH"] = os.pathsep.join([sysconfig.get_path("scripts"), os.environ.get("PATH", os.defpath)])


_FOLDERS: Final = ("web", "drive", "tests", "model", "viz", "common", "simulator", "recorder", "dataset")


def pytest_configure(config: pytest.Config) -> None:
    gc.disable()  # a tenth of the collection, which makes no garbage to speak of
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):  # no windows open because somebody tests
        os.environ.pop(name, None)
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # a shell starts what is in the background like that
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(tryfirst=True)  # before those of other marks are left out
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Files of few and long tests first: at the end no process waits for another one's minute."""
    place = {folder: number for number, folder in enumerate(_FOLDERS)}
    items.sort(key=lambda item: place.get(item.path.parent.name, 0))


def pytest_collection_finish() -> None:
    gc.enable()
    gc.freeze()  # what is loaded by now stays: else each collection of garbage looks through PyTorch again


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


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """`make coverage` keeps which test ran a line."""
    if "coverage" in sys.modules and (measured := sys.modules["coverage"].Coverage.current()):
        measured.switch_context(item.nodeid)
    return (yield)


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
    """One for all pages, and one window of it (pages.py); another one after Chromium has crashed."""
    return _browsers()


@pytest.fixture
def cwd(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, in which the test works."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def project(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The project of somebody who has an empty cache: a folder, in which the test works."""
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    (tmp_path / "project").mkdir()
    monkeypatch.chdir(tmp_path / "project")
    return tmp_path / "project"


@pytest.fixture(scope="session")
def index(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The index of toy.py's road; its log lies beside it. It is for reading alone."""
    from tests.helpers.toy import toy_index  # PyTorch

    return toy_index(tmp_path_factory.mktemp("toy"))


@pytest.fixture(scope="session")
def trained(index: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run of one epoch on that index, named `first`, alone in its folder. It is for reading alone."""
    from model import train  # PyTorch
    from tests.helpers.toy import ONE

    return train(index, tmp_path_factory.mktemp("runs") / "first", ONE, show_progress=False).run


@pytest.fixture(scope="module")
def exported_once() -> Iterator[None]:
    """What is made of an ONNX export is tested, and not the export itself."""
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
    """For what is true on a disk and in a bucket alike: how a command is told of a file that the test has made."""
    if request.param == "disk":
        return lambda path: path
    for name, value in request.getfixturevalue("bucket_of_tests").items():
        monkeypatch.setenv(name, value)
    monkeypatch.setenv("BC_CACHE", str(tmp_path_factory.mktemp("cache")))
    return url_within(tmp_path_factory.getbasetemp())


@pytest.fixture
def bucket(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bucket]:
    """An empty bucket of its own, for who works in an empty folder and has nothing cached yet."""
    from tests.helpers.bucket import serving_bucket  # obstore

    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    with serving_bucket(tmp_path / "server", monkeypatch) as served:
        yield served
