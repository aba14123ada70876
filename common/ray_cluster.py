"""Run calls on a Ray cluster: each call is a task, which Ray repeats if its node dies.

Work on one machine does not import this module; `pip install ".[scale]"` installs Ray. Files are not sent: a task
works in the folder in which the command was started, so that every path means the same.

Ray unpickles its input, and runs code for anybody who reaches its ports: see docs/scale.md.
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
from typing import Any, Final, Protocol, TypeVar

from common.errors import UsageError, UserError, printable
from common.grpc_probe import speaks_grpc
from common.output import print_message
from common.versions import TOOLKIT, install_line, version_of

Result = TypeVar("Result")

SAME_VERSIONS: Final = (TOOLKIT, "numpy", "pyarrow", "opencv-python-headless", "torch")
"""Packages that write the results: a node with other versions would write other bytes."""

UNREACHABLE_S: Final = 8.0
"""A cluster that does not answer within this time is unreachable. Ray itself tries for more than a minute, and
then ends the process."""

_NOTICE_AFTER_S: Final = 10.0
"""If the start takes longer, a message explains the wait."""

MAX_RETRIES: Final = 5
"""A call is given up when its process dies for the sixth time: the call itself may kill the process."""

_MAX_MESSAGE_CHARACTERS: Final = 300  # of a node's message
_MAX_TASKS: Final = 4_000
"""A task costs the driver 1 to 2 ms. If there are more calls than this, several calls share a task."""

_IN_FLIGHT: Final = 1_000
_READY_AT_ONCE: Final = 64
_POLL_EVERY_S: Final = 0.5

_ADDRESS: Final = re.compile(r"(ray://)?(\[[0-9a-fA-F:]+\]|[^\s:/\[\]]+):(\d{1,5})")
_LOCAL_ADDRESSES: Final = ("", "auto", "local")


class ClusterError(UserError):
    """The cluster cannot be reached, or its nodes cannot run the toolkit."""


@dataclass(frozen=True)
class _Failed:
    error: Exception


class ClusterTasks(Protocol):
    """`common.tasks.Tasks` on a cluster."""

    def __call__(
        self,
        function: Callable[..., Result],
        calls: Sequence[tuple[Any, ...]],
        while_waiting: Callable[[], object] | None = None,
    ) -> Iterator[tuple[int, Result]]:
        """`while_waiting` is called twice a second. With it, Ctrl-C raises KeyboardInterrupt in the calls, too,
        and waits for their end: they may save what they have done. The second Ctrl-C does not wait.
        """


def address_of(flag: Sequence[str]) -> str:
    """The address in `--ray [ADDRESS]`; "" if Ray is to find the cluster. Raises UsageError if it is no
    address."""
    if len(flag) > 1:
        raise UsageError(f"--ray {' '.join(flag)}: at most one address; names go before --ray")
    address = flag[0] if flag else ""
    if address not in _LOCAL_ADDRESSES and not _ADDRESS.fullmatch(address):
        raise UsageError(
            f"--ray {address}: expected HOST:PORT, ray://HOST:PORT, auto or local; names go before --ray"
        )
    return address


@contextlib.contextmanager
def cluster_tasks(address: str = "", gpus: int | None = 0, cpus: int = 1) -> Iterator[ClusterTasks]:
    """Connect to a cluster, and yield the function that makes calls on the cluster. Each call has `cpus`
    processor cores and `gpus` GPUs to itself; if `gpus` is None, one GPU if a node has one.

    `address` is one of

    - HOST:PORT of the head, if this machine is a node of the cluster; ray://HOST:PORT from other machines
    - "auto": the cluster that has this machine as a node
    - "local": start a cluster on this machine alone
    - "": RAY_ADDRESS, else "auto", else "local"

    Raises ClusterError if no cluster answers, if the nodes have other versions of `SAME_VERSIONS`, or if no node
    has so many cores or GPUs.
    """
    with _connection(address) as ray:
        nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
        with_gpu = [node for node in nodes if node.get("GPU", 0) >= 1]
        gpus = min(1, len(with_gpu)) if gpus is None else gpus
        # for what no node has, Ray would wait for ever
        if gpus and not with_gpu:
            raise ClusterError(f"--ray {address or 'auto'}: no node of the cluster has a GPU; give --device cpu")
        most = int(max((node.get("CPU", 0) for node in (with_gpu if gpus else nodes)), default=0))
        if 0 < most < cpus:  # 0: a cluster that adds nodes when there is work
            raise ClusterError(
                f"--ray {address or 'auto'}: no node of the cluster has {cpus} cores, for as many threads; give"
                f" --threads {most}"
            )
        yield partial(_results, ray, cpus, gpus)


@contextlib.contextmanager
def _connection(address: str) -> Iterator[Any]:
    """Yield the module `ray`, connected to a cluster. See `cluster_tasks`."""
    os.environ.setdefault("RAY_CLIENT_MAX_CONNECTION_TIMEOUT_S", str(round(UNREACHABLE_S)))
    try:
        import ray
    except ImportError:
        raise ClusterError(f"--ray: Ray is not installed; run `{install_line('scale')}`") from None
    address = address or os.environ.get("RAY_ADDRESS", "")
    if address not in _LOCAL_ADDRESSES:
        _check_answers(address)
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # a local cluster sends no statistics
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # Ray's behaviour since 2.55; unset, it warns
    if address == "local":  # only this command uses the cluster: its tasks get the command's priority
        os.environ.setdefault("RAY_worker_niceness", "0")
    sigterm_handler = signal.getsignal(signal.SIGTERM)  # Ray replaces it
    where = "of this machine" if address == "local" else address or "that Ray finds"
    waiting = threading.Timer(
        _NOTICE_AFTER_S, print_message, [f"--ray: waiting for the cluster {where} to start and to answer"]
    )
    waiting.daemon = True
    waiting.start()
    try:
        with warnings.catch_warnings(action="ignore"):
            ray.init(address or None, log_to_driver=False, logging_level="ERROR")
    except ray.exceptions.AuthenticationError:  # Ray connects to nothing without a token
        raise ClusterError(
            f"--ray {address or 'auto'}: RAY_AUTH_MODE is set, but this machine has no token: run"
            " `ray get-auth-token` on the cluster's head, and write the token to ~/.ray/auth_token"
        ) from None
    except (ConnectionError, TimeoutError, RuntimeError, ValueError) as error:
        raise ClusterError(_why_not(address, str(error))) from None
    finally:
        waiting.cancel()
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, sigterm_handler)
    try:
        with _messages_in_one_line(ray):
            yield ray
    finally:
        ray.shutdown()


@contextlib.contextmanager
def _messages_in_one_line(ray: Any) -> Iterator[None]:
    """Print each message of a node in one line. Ray prints 36 lines on stdout when a node dies."""
    worker = ray._private.worker
    before = getattr(worker, "print_to_stdstream", None)
    worker.print_to_stdstream = print_node_message
    try:
        yield
    finally:
        worker.print_to_stdstream = before


def print_node_message(data: Mapping[str, Any], ignore_prefix: bool = False) -> None:
    """Print the first line of a node's message; `data` has Ray's format."""
    lines = (line.strip() for text in data.get("lines", ()) for line in str(text).splitlines())
    first = next((line for line in lines if line and not line.startswith("[state-dump]")), "")
    if first:
        print_message(f"--ray: {printable(first[:_MAX_MESSAGE_CHARACTERS])}")


def _check_answers(address: str) -> None:
    """Raise ClusterError unless a gRPC server answers at the address."""
    matched = _ADDRESS.fullmatch(address)
    if matched is None:
        raise ClusterError(f"RAY_ADDRESS={address}: expected HOST:PORT or ray://HOST:PORT")
    host, port = matched[2].strip("[]"), int(matched[3])
    try:
        with socket.create_connection((host, port), UNREACHABLE_S / 2) as stream:
            if os.environ.get("RAY_USE_TLS", "0") in ("0", ""):
                stream.settimeout(UNREACHABLE_S / 2)
                if not speaks_grpc(stream):
                    raise ClusterError(f"--ray {address}: another program than Ray listens on this port")
    except (OSError, OverflowError) as error:
        why = "no answer" if isinstance(error, TimeoutError) else getattr(error, "strerror", None) or str(error)
        raise ClusterError(
            f"--ray {address}: the cluster cannot be reached ({why}); run `ray status` on its head"
        ) from None


def _why_not(address: str, error: str) -> str:
    """Ray's error about the connection, in one line."""
    versions = re.findall(r"(Ray|Python): (\S+)", error)
    if "ersion mismatch" in error and len(versions) == 4:
        theirs, ours = (" and ".join(map(" ".join, pair)) for pair in (versions[:2], versions[2:]))
        return f"--ray {address}: the cluster has {theirs}, this machine {ours}: they must be the same"
    line = printable(" ".join(error.split())[:300])
    is_open = address not in _LOCAL_ADDRESSES and "RAY_AUTH_MODE" not in os.environ
    hint = "; if the cluster needs a token, set RAY_AUTH_MODE=token (`ray get-auth-token` on its head)"
    return f"--ray {address or 'auto'}: {line}{hint if is_open else ''}"


def _results(
    ray: Any,
    cpus: int,
    gpus: int,
    function: Callable[..., Result],
    calls: Sequence[tuple[Any, ...]],
    while_waiting: Callable[[], object] | None = None,
) -> Iterator[tuple[int, Result]]:
    name = function.__name__.strip("_")
    call = ray.remote(_call).options(num_cpus=cpus, num_gpus=gpus, max_retries=MAX_RETRIES, name=name)
    versions, folder = package_versions(), Path.cwd()
    size = -(-len(calls) // _MAX_TASKS)
    firsts: dict[Any, int] = {}  # for each running task: the number of its first call
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
            if while_waiting is not None:
                while_waiting()
    except KeyboardInterrupt:
        if while_waiting is not None:
            for reference in firsts:
                ray.cancel(reference)
            ray.wait(list(firsts), num_returns=len(firsts))
        raise
    finally:
        if firsts:  # Ctrl-C, or an error: the cluster ends the tasks of a driver that has left. `ray.cancel` is
            ray.shutdown()  # not used here: for a task that has just failed, Ray 2.60 may abort the process


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
    addresses = re.findall(r"ip=([\d.a-fA-F:]+)", error)
    module = missing[-1] if missing else "the toolkit"
    needed = f"every node needs {TOOLKIT}[scale] {version_of()}"
    return f"the cluster's node {addresses[-1] if addresses else ''} cannot import {module}: {needed}"


def package_versions() -> dict[str, str]:
    """The version of each package of `SAME_VERSIONS`."""
    return {package: version_of(package) for package in SAME_VERSIONS}


def refuse_other_node(versions: Mapping[str, str], folder: Path) -> None:
    """On a node: change to the driver's `folder`. Raises ClusterError if the node has other versions than the
    driver, or lacks the folder."""
    node = socket.gethostname()
    installed = package_versions()
    if different := [name for name, version in installed.items() if version != versions[name]]:
        has, wanted = (", ".join(f"{name} {table[name]}" for name in different) for table in (installed, versions))
        raise ClusterError(f"the cluster's node {node} has {has}, this machine {wanted}: they must be the same")
    try:
        os.chdir(folder)
    except OSError as error:
        why = f"({error.strerror}); all nodes must share the disk of logs, index and runs, under the same path"
        raise ClusterError(f"the cluster's node {node} has no {folder} {why}") from None


def _call(
    function: Callable[..., Result], calls: Sequence[tuple[Any, ...]], versions: Mapping[str, str], folder: Path
) -> list[Result | _Failed]:
    """On a node: the results of the calls, up to the first that fails. Errors in the user's files are returned,
    because Ray would wrap a raised error."""
    results: list[Result | _Failed] = []
    try:
        refuse_other_node(versions, folder)
        for arguments in calls:
            results.append(function(*arguments))
    except (UserError, OSError) as error:
        results.append(_Failed(error))
    return results
