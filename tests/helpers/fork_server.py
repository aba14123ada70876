"""Runs the Python code that forked.py sends it, each in a fork of this process, which has loaded what takes long.

A program of its own: it begins no thread and runs little but imports, so that a fork of it is as good as a start.
Its standard input is a connection on which each request comes, as JSON with four open files: the new process's
standard streams, and a socket that is told its number and then its status as `os.waitpid` gives it.
"""

import atexit
import contextlib
import gc
import importlib
import json
import os
import selectors
import signal
import socket
import sys
import threading
import warnings
import weakref
from typing import Any, NoReturn

LOADED = (
    *("torch", "cv2", "pyarrow.compute", "pyarrow.parquet", "rich.progress"),
    *("tyro._backends._tyro_backend", "typeguard"),
    *("model.cli", "model.pilot", "model.training.trainer", "dataset.index_command", "drive.cli"),
    *("recorder.record_command", "recorder.upkeep.check", "recorder.upkeep.edit", "recorder.upkeep.recover"),
    *("dataset.cli", "recorder.cli", "recorder.log_cli"),
    "recorder.server.eventlet_host",
    *("drive.evaluation.eval_cli", "drive.evaluation.closed_loop", "simulator.cli", "viz.cli"),
)
LOADED_IF_INSTALLED = (
    "pandas",  # by pyarrow
    *("rerun", "viz.playback.rerun_recording"),
    *("web.cli", "web.app", "web.server.workbench_server"),
)


def serve() -> dict[str, Any]:
    """Fork for each request; return in each fork, with the request. The server itself ends with the connection."""
    connection = socket.socket(fileno=os.dup(0))
    ended, wake = socket.socketpair()
    for end in (ended, wake):
        end.setblocking(False)
    signal.signal(signal.SIGCHLD, lambda *_: None)
    signal.set_wakeup_fd(wake.fileno())
    told: dict[int, socket.socket] = {}
    selector = selectors.DefaultSelector()
    for socket_read in (connection, ended):
        selector.register(socket_read, selectors.EVENT_READ)
    while True:
        for key, _ in selector.select():
            if key.fileobj is ended:
                ended.recv(4096)
                tell_ended(told)
                continue
            sent, files, _, _ = socket.recv_fds(connection, 1 << 20, 4)
            if not sent:
                os._exit(0)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", DeprecationWarning)  # jemalloc's thread minds no fork
                process = os.fork()
            if process:
                for file in files[:3]:
                    os.close(file)
                told[process] = socket.socket(fileno=files[3])
                told[process].send(b"%d\n" % process)
                continue
            signal.set_wakeup_fd(-1)
            signal.signal(signal.SIGCHLD, signal.SIG_DFL)
            selector.close()
            for other in (connection, ended, wake, *told.values()):
                other.close()
            for number, file in enumerate(files[:3]):
                os.dup2(file, number)
            for file in files:
                os.close(file)
            request: dict[str, Any] = json.loads(sent)
            return request


def tell_ended(told: dict[int, socket.socket]) -> None:
    while told:
        process, status = os.waitpid(-1, os.WNOHANG)
        if not process:
            return
        with told.pop(process) as answer, contextlib.suppress(OSError):  # nobody waits for it any more
            answer.send(b"%d\n" % status)


def run_to_its_end(code: str) -> NoReturn:
    """Run it as `python -c` does, but for the deletion of each object at the end: that takes a quarter of a second
    of PyTorch's. So ends multiprocessing what it has forked, too."""
    status: object = 0
    try:
        exec(compile(code, "<string>", "exec"), {"__name__": "__main__"})
    except SystemExit as end:
        status = end.code or 0
        if not isinstance(status, int):
            print(status, file=sys.stderr)
            status = 1
    except BaseException as error:
        sys.excepthook(type(error), error, error.__traceback__)
        status = error
    threading._shutdown()  # type: ignore[attr-defined]
    atexit._run_exitfuncs()
    for stream in (sys.stdout, sys.stderr):
        try:
            if not stream.closed:
                stream.flush()
        except OSError:
            status = status or 120  # as Python's own
    if isinstance(status, KeyboardInterrupt):
        signal.signal(signal.SIGINT, signal.SIG_DFL)
        os.kill(os.getpid(), signal.SIGINT)
    os._exit(status if isinstance(status, int) else 1)


for name in LOADED:
    importlib.import_module(name)
os.environ.setdefault(
    "RUST_LOG", importlib.import_module("viz.viewer_process").SENDER_LOG
)  # as bc-play, for Rerun
for name in LOADED_IF_INSTALLED:
    with contextlib.suppress(ImportError):
        importlib.import_module(name)
gc.freeze()  # else each fork looks through all of it at each collection of garbage
for finalizer in weakref.finalize._registry:  # type: ignore[attr-defined]
    finalizer.atexit = False  # PyTorch's operators, forgotten one by one: half of what a short command costs
request = serve()
os.chdir(request["cwd"])
os.environ.clear()
os.environ.update(request["environment"])
sys.argv[1:] = request["arguments"]
run_to_its_end(request["code"])
