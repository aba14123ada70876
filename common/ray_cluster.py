"""Calls made by a Ray cluster: each is a task there, and is made again where its node died.

Work on one machine does not import it; `pip install ".[scale]"` brings Ray. Files are not sent: a task works in
the folder that the command was started in, so that every path means the same.

Ray unpickles what it is sent, and runs code for anybody who reaches its ports: see docs/scale.md.
"""

from __future__ import annotations

import contextlib
import os
import re
import signal
import socket
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Final, TypeVar

from common.errors import UsageError, UserError, printable
from common.grpc_probe import speaks_grpc
from common.output import print_message
from common.tasks import Tasks
from common.versions import TOOLKIT, install_line, version_of

Result = TypeVar("Result")

SAME_VERSIONS: Final = (TOOLKIT, "numpy", "pyarrow", "opencv-python-headless", "torch")
"""Packages that write the results: with other versions of them, a node's would have other bytes."""

UNREACHABLE_S: Final = 8.0
"""Ray itself tries for more than a minute, and then ends the process."""

_NOTICE_AFTER_S: Final = 10.0
"""A start that takes longer says what it waits for."""

MAX_RETRIES: Final = 5
"""A call whose process died for the sixth time is given up: it may be the call that kills it."""

_MAX_MESSAGE_CHARACTERS: Final = 300  # of a node's message
_MAX_TASKS: Final = 4_000
"""Each costs the driver a millisecond or two: of more calls, several are one task."""

_IN_FLIGHT: Final = 1_000
_READY_AT_ONCE: Final = 64
_POLL_EVERY_S: Final = 0.5

_ADDRESS: Final = re.compile(r"(ray://)?(\[[0-9a-fA-F:]+\]|[^\s:/\[\]]+):(\d{1,5})")
_LOCAL_ADDRESSES: Final = ("", "auto", "local")


class ClusterError(UserError):
    """A cluster that cannot be reached, or on whose nodes nothing of ours can run."""


@dataclass(frozen=True)
class _Failed:
    error: Exception


def address_of(flag: Sequence[str]) -> str:
    """The address that `--ray [ADDRESS]` gives, or "" if Ray finds one by itself. Raises UsageError for anything
    else."""
    if len(flag) > 1:
        raise UsageError(f"--ray {' '.join(flag)}: at most one address; names go before --ray")
    address = flag[0] if flag else ""
    if address not in _LOCAL_ADDRESSES and not _ADDRESS.fullmatch(address):
        raise UsageError(
            f"--ray {address}: HOST:PORT, ray://HOST:PORT, auto or local was expected; names go before --ray"
        )
    return address


@contextlib.contextmanager
def cluster_tasks(address: str = "") -> Iterator[Tasks]:
    """Connect to a cluster, and yield what makes calls there.

    `address` is HOST:PORT of its head, from one of its nodes; ray://HOST:PORT from elsewhere; "auto" a cluster
    that this machine is a node of; "local" starts one on this machine alone; "" is RAY_ADDRESS, else
    "auto", else "local". Raises ClusterError if there is none, or its versions are others.
    """
    with _connection(address) as ray:
        yield partial(_results, ray)


@contextlib.contextmanager
def _connection(address: str) -> Iterator[Any]:
    """The module `ray`, connected to a cluster in the block. See `cluster_tasks`."""
    os.environ.setdefault("RAY_CLIENT_MAX_CONNECTION_TIMEOUT_S", str(round(UNREACHABLE_S)))
    try:
        import ray
    except ImportError:
        raise ClusterError(f"--ray: Ray is not installed here; `{install_line('scale')}` brings it") from None
    address = address or os.environ.get("RAY_ADDRESS", "")
    if address not in _LOCAL_ADDRESSES:
        _check_answers(address)
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a cluster that is started here reports to nobody
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # its way from 2.55 on; otherwise it warns
    if address == "local":  # nobody else's cluster: its tasks are what the command is there for, and as important
        os.environ.setdefault("RAY_worker_niceness", "0")
    before = signal.getsignal(signal.SIGTERM)  # Ray puts its own in its place
    where = "of this machine" if address == "local" else address or "that is found by itself"
    waiting = threading.Timer(
        _NOTICE_AFTER_S, print_message, [f"--ray: waiting for the cluster {where} to start and to answer"]
    )
    waiting.daemon = True
    waiting.start()
    try:
        with warnings.catch_warnings(action="ignore"):
            ray.init(address or None, log_to_driver=False, logging_level="ERROR")
    except ray.exceptions.AuthenticationError:  # before anybody is asked
        raise ClusterError(
            f"--ray {address or 'auto'}: RAY_AUTH_MODE is set, but this machine has no token: put the one that"
            " `ray get-auth-token` prints on its head into ~/.ray/auth_token"
        ) from None
    except (ConnectionError, TimeoutError, RuntimeError, ValueError) as error:
        raise ClusterError(_why_not(address, str(error))) from None
    finally:
        waiting.cancel()
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, before)
    try:
        with _messages_in_one_line(ray):
            yield ray
    finally:
        ray.shutdown()


@contextlib.contextmanager
def _messages_in_one_line(ray: Any) -> Iterator[None]:
    """Print the messages of Ray's nodes in a line each: that of a node which died has 36, on standard output."""
    worker = ray._private.worker
    before = getattr(worker, "print_to_stdstream", None)
    worker.print_to_stdstream = print_node_message
    try:
        yield
    finally:
        worker.print_to_stdstream = before


def print_node_message(data: Mapping[str, Any], ignore_prefix: bool = False) -> None:
    """Print the first line of a message of a node; `data` is as Ray has it."""
    lines = (line.strip() for text in data.get("lines", ()) for line in str(text).splitlines())
    first = next((line for line in lines if line and not line.startswith("[state-dump]")), "")
    if first:
        print_message(f"--ray: {printable(first[:_MAX_MESSAGE_CHARACTERS])}")


def _check_answers(address: str) -> None:
    """Raise ClusterError unless a gRPC server answers there."""
    matched = _ADDRESS.fullmatch(address)
    if matched is None:
        raise ClusterError(f"RAY_ADDRESS={address}: HOST:PORT or ray://HOST:PORT was expected")
    host, port = matched[2].strip("[]"), int(matched[3])
    try:
        with socket.create_connection((host, port), UNREACHABLE_S / 2) as stream:
            if os.environ.get("RAY_USE_TLS", "0") in ("0", ""):
                stream.settimeout(UNREACHABLE_S / 2)
                if not speaks_grpc(stream):
                    raise ClusterError(f"--ray {address}: a program other than Ray listens there")
    except (OSError, OverflowError) as error:
        why = "no answer" if isinstance(error, TimeoutError) else getattr(error, "strerror", None) or str(error)
        raise ClusterError(
            f"--ray {address}: no cluster can be reached there ({why}); `ray status` on its head shows its state"
        ) from None


def _why_not(address: str, error: str) -> str:
    """Ray's error about a cluster that cannot be used, in one line."""
    versions = re.findall(r"(Ray|Python): (\S+)", error)
    if "ersion mismatch" in error and len(versions) == 4:
        theirs, ours = (" and ".join(map(" ".join, pair)) for pair in (versions[:2], versions[2:]))
        return f"--ray {address}: the cluster has {theirs}, this machine {ours}: they must be the same"
    line = printable(" ".join(error.split())[:300])
    is_open = address not in _LOCAL_ADDRESSES and "RAY_AUTH_MODE" not in os.environ
    hint = "; a cluster that asks for a token needs RAY_AUTH_MODE=token here (`ray get-auth-token` on its head)"
    return f"--ray {address or 'auto'}: {line}{hint if is_open else ''}"


def _results(
    ray: Any, function: Callable[..., Result], calls: Sequence[tuple[Any, ...]]
) -> Iterator[tuple[int, Result]]:
    name = function.__name__.strip("_")
    call = ray.remote(_call).options(num_cpus=1, max_retries=MAX_RETRIES, name=name)
    versions, folder = package_versions(), Path.cwd()
    size = -(-len(calls) // _MAX_TASKS)
    firsts: dict[Any, int] = {}  # of each task that goes on, the number of its first call
    to_do = iter(range(0, len(calls), max(1, size)))
    try:
        while True:
            while len(firsts) < _IN_FLIGHT and (first := next(to_do, None)) is not None:
                firsts[call.remote(function, calls[first : first + size], versions, folder)] = first
            if not firsts:
                return
            pending = list(firsts)
            ready, _ = ray.wait(pending, num_returns=min(len(pending), _READY_AT_ONCE), timeout=_POLL_EVERY_S)
            for reference in ready:
                first = firsts.pop(reference)
                for number, result in enumerate(_get(ray, reference), first):
                    if isinstance(result, _Failed):
                        raise result.error
                    yield number, result
    finally:
        if firsts:  # Ctrl-C, or an error: the cluster ends what a driver has left there. Ray 2.60 may abort the
            ray.shutdown()  # process where a task is cancelled that has just failed


def _get(ray: Any, reference: Any) -> list[Any]:
    try:
        results: list[Any] = ray.get(reference)
    except ray.exceptions.RayTaskError as error:
        if "No module named" in str(error) or "failed to import" in str(error):
            raise ClusterError(_without_toolkit(str(error))) from None
        raise
    except ray.exceptions.RayError as error:
        why = printable(" ".join(str(error).split())[:300])
        raise ClusterError(f"a task has failed {MAX_RETRIES + 1} times: {why}") from None
    return results


def _without_toolkit(error: str) -> str:
    missing = re.findall(r"No module named '([\w.]+)'", error)
    where = re.findall(r"ip=([\d.a-fA-F:]+)", error)
    what = missing[-1] if missing else "the toolkit"
    needed = f"every node needs {TOOLKIT}[scale] {version_of()}"
    return f"the cluster's node {where[-1] if where else ''} cannot import {what}: {needed}"


def package_versions() -> dict[str, str]:
    """The versions that `refuse_other_node` compares."""
    return {package: version_of(package) for package in SAME_VERSIONS}


def refuse_other_node(versions: Mapping[str, str], folder: Path) -> None:
    """To be called on a node: work in the driver's `folder`. Raises ClusterError if it has other versions than the
    driver's, or no such folder."""
    node = socket.gethostname()
    installed = package_versions()
    if different := [name for name, version in installed.items() if version != versions[name]]:
        has, wanted = (", ".join(f"{name} {table[name]}" for name in different) for table in (installed, versions))
        raise ClusterError(f"the cluster's node {node} has {has}, this machine {wanted}: they must be the same")
    try:
        os.chdir(folder)
    except OSError as error:
        why = f"({error.strerror}); logs, index and runs must lie on a disk that all nodes share, by the same path"
        raise ClusterError(f"the cluster's node {node} has no {folder} {why}") from None


def _call(
    function: Callable[..., Result],
    calls: Sequence[tuple[Any, ...]],
    versions: Mapping[str, str],
    folder: Path,
) -> list[Result | _Failed]:
    """Runs on a node: the results of these calls, up to the first that fails. What its caller's files are to blame
    for is returned: Ray would wrap what is raised."""
    results: list[Result | _Failed] = []
    try:
        refuse_other_node(versions, folder)
        for arguments in calls:
            results.append(function(*arguments))
    except (UserError, OSError) as error:
        results.append(_Failed(error))
    return results
