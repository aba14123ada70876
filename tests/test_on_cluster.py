"""`--ray`: what one machine would make, byte for byte; what is said where it cannot be; and nodes that die.

One file for all commands, because one cluster takes seconds to start."""

from __future__ import annotations

import contextlib
import json
import os
import re
import signal
import socket
import subprocess
import sysconfig
import threading
import time
import venv
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import cv2
import jsonschema
import numpy as np
import pytest
import yaml

from common.car import Camera
from common.errors import UserError
from common.ray_cluster import (
    ClusterError,
    cluster_tasks,
    print_node_message,
)
from common.tasks import Tasks, one_by_one
from dataset import build_index
from drive.config import DriveConfig
from drive.evaluation.closed_loop import BuiltInSimulator, drive_runs
from recorder.upkeep.check import check
from tests.helpers.bucket import serving_bucket
from tests.helpers.clusters import ray_cluster
from tests.helpers.driving import Process, command, one_line_of, run_alone, run_code, untrained_run
from tests.helpers.logs import not_a_picture, write_log
from tests.helpers.ports import free_ports
from tests.helpers.repository import ROOT
from tests.helpers.toy import toy_index
from tests.helpers.udacity import make_recording, paths
from tests.helpers.waiting import wait_until


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with ray_cluster(nodes=2) as started:
        yield started


@pytest.fixture(scope="module")
def small_cluster() -> Iterator[Any]:
    """Two tasks at a time, on one node."""
    with ray_cluster(nodes=0, head_processors=2) as started:
        yield started


def drives(folder: Path, sessions: int = 4, picture: Callable[[Camera, int], bytes] = not_a_picture) -> list[Path]:
    """Logs of a car that winds along, each at a time of its own."""
    rows = np.arange(120)
    return [
        write_log(
            folder / f"drive {n}.mcap", np.sin(rows / (5 + n)).tolist(), picture, start_ns=10**18 + n * 10**15
        )
        for n in range(sessions)
    ]


def tiny_picture(camera: Camera, row: int) -> bytes:
    """A JPEG; row 7's is none."""
    pixels = np.random.default_rng((row, len(camera))).integers(0, 256, (8, 8, 3), np.uint8)
    return b"no picture" if row == 7 else cv2.imencode(".jpg", pixels)[1].tobytes()


@contextlib.contextmanager
def serving_pages() -> Iterator[str]:
    """The address of a web server."""
    with ThreadingHTTPServer(("127.0.0.1", 0), BaseHTTPRequestHandler) as server:
        thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        try:
            yield f"127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()


def messages(stderr: str) -> list[str]:
    """Without how far it is, which is told where something takes long."""
    return [line for line in stderr.splitlines() if " %" not in line]


def index_files(index: Path) -> dict[str, bytes]:
    """What of an index does not tell when it was made."""
    files = sorted(index.rglob("*.parquet"))
    return {str(path.relative_to(index)): path.read_bytes() for path in files}


def test_the_index_has_the_same_bytes_and_omits_a_damaged_log(tmp_path: Path, small_cluster: Any) -> None:
    drives(tmp_path / "sessions", picture=tiny_picture)
    (tmp_path / "sessions" / "damaged.mcap").write_bytes(b"this is no log")
    local = run_alone("bc-index", "--look", "--index", "here", cwd=tmp_path)
    remote = run_alone("bc-index", "--look", "--index", "there", "--ray", small_cluster.address, cwd=tmp_path)
    assert (local.returncode, remote.returncode) == (3, 3), remote.stderr
    assert messages(remote.stderr) == [line.replace("here", "there") for line in messages(local.stderr)]
    assert "sessions/damaged.mcap: not an MCAP log" in remote.stderr
    assert remote.stdout == local.stdout.replace("here:", "there:")
    assert index_files(tmp_path / "there") == index_files(tmp_path / "here")
    assert len(index_files(tmp_path / "there")) == 5
    looks = [
        {path.name: path.read_bytes() for path in (tmp_path / index / "looks").iterdir()}
        for index in ("here", "there")
    ]
    assert looks[0] == looks[1]
    assert json.loads(looks[0]["drive 0.json"])["broken"]["left"] == [[7, 7]]


@contextlib.contextmanager
def tasks_whose_node_dies(folder: Path) -> Iterator[Tasks]:
    """Calls on a cluster of one node, which goes when the last one is done, and nobody knows its result yet. Then
    another node comes."""
    began, gone = folder / "began", folder / "gone"

    def holding(function: Callable[..., Any]) -> Callable[..., Any]:
        def call(is_held: bool, *arguments: Any) -> Any:
            result = function(*arguments)
            if is_held and not gone.exists():
                began.write_text("")
                time.sleep(1_000)
            return result

        return call

    with ray_cluster(nodes=0) as cluster:
        dying = cluster.add_node(num_cpus=1, include_dashboard=False)
        with cluster_tasks(cluster.address) as run_there:

            def tasks(function: Callable[..., Any], calls: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Any]]:
                marked = [(number == len(calls) - 1, *arguments) for number, arguments in enumerate(calls)]
                for number, result in run_there(holding(function), marked):
                    if not gone.exists():
                        wait_until(began.exists)
                        gone.write_text("")
                        cluster.remove_node(dying, allow_graceful=False)
                        cluster.add_node(num_cpus=1, include_dashboard=False)
                    yield number, result

            yield tasks
    assert gone.exists()


@pytest.mark.long
def test_a_node_that_dies_in_the_middle_costs_nothing_of_the_index(tmp_path: Path) -> None:
    logs = drives(tmp_path / "sessions")
    build_index(logs, tmp_path / "here")
    with tasks_whose_node_dies(tmp_path) as tasks:
        build_index(logs, tmp_path / "there", tasks=tasks)
    assert index_files(tmp_path / "there") == index_files(tmp_path / "here")


@pytest.mark.long
def test_a_node_that_dies_in_the_middle_costs_nothing_of_the_drives(tmp_path: Path) -> None:
    run = untrained_run(tmp_path / "runs" / "untrained")
    lake = BuiltInSimulator("lake", laps=0.002)
    drives = [(lake, DriveConfig(set_speed_mph=speed)) for speed in (8, 12)]
    local = dict(drive_runs([(run, tmp_path / "here")], drives, one_by_one))
    with tasks_whose_node_dies(tmp_path) as tasks:
        remote = dict(drive_runs([(run, tmp_path / "there")], drives, tasks))
    assert sorted(remote) == [0, 1]
    for number, driven in remote.items():
        assert driven.report["trajectory_sha256"] == local[number].report["trajectory_sha256"]
        assert not check(driven.log).findings
    assert len(list((tmp_path / "there").iterdir())) == 2


def test_recordings_are_imported_to_the_same_sessions(tmp_path: Path, small_cluster: Any) -> None:
    for number, name in enumerate(("monday", "tuesday")):
        rows = "".join(f"{paths(row)},0.{number},0.5,0,9\n" for row in range(3))
        make_recording(tmp_path / "theirs/drives" / name, rows)
    make_recording(tmp_path / "theirs/empty", "")
    local = run_alone("bc-import", "theirs", "--all", "--sessions", "here", cwd=tmp_path)
    cluster = ("--ray", small_cluster.address)
    remote = run_alone("bc-import", "theirs", "--all", "--sessions", "there", *cluster, cwd=tmp_path)
    assert (local.returncode, remote.returncode) == (3, 3), remote.stderr
    expected = [line.replace("sessions here", "sessions there") for line in messages(local.stderr)]
    assert sorted(messages(remote.stderr)) == sorted(expected)
    assert "theirs/empty/driving_log.csv: " in remote.stderr
    assert sorted(remote.stdout.splitlines()) == sorted(local.stdout.replace("here", "there").splitlines())
    logs = [
        {path.name: path.read_bytes() for path in (tmp_path / folder).iterdir()} for folder in ("here", "there")
    ]
    assert logs[0] == logs[1]
    assert sorted(logs[0]) == ["drives-monday.mcap", "drives-tuesday.mcap"]


TRAINING = ("--network", "small", "--batch", 4, "--precision", "float32", "--index", "index")


def epoch_lines(stdout: str) -> list[str]:
    return re.findall(r"^epoch +\d+: .*correlation [\d.-]+", stdout, re.MULTILINE)


def weights(run: Path) -> list[bytes]:
    return [(run / name).read_bytes() for name in ("model.safetensors", "last/checkpoint.safetensors")]


def started_training(cluster: Any, folder: Path, epochs: int) -> Process:
    """`bc-train --name there --ray`, which has learnt an epoch."""
    toy_index(folder)
    flags = ("--name", "there", *TRAINING, "--epochs", epochs, "--ray", cluster.address)
    training = Process(command("bc-train", *flags), cwd=folder)
    metrics = folder / "runs/there/metrics.jsonl"
    wait_until(lambda: metrics.exists() or training.popen.poll() is not None)
    return training


def test_a_training_that_ctrl_c_stopped_resumes_to_the_same_weights(tmp_path: Path, small_cluster: Any) -> None:
    with started_training(small_cluster, tmp_path, epochs=2000) as training:
        assert training.end(signal.SIGINT) == 130, training.stderr
    assert training.stderr[-2].endswith("bc-train resume there`")
    assert training.stderr[-1] == "bc-train: stopped"
    learnt = epoch_lines(training.stdout)
    assert len(learnt) == len((tmp_path / "runs/there/metrics.jsonl").read_text().splitlines())
    epochs = ("--epochs", len(learnt) + 1)
    resumed = run_alone("bc-train", "resume", "there", *epochs, "--ray", small_cluster.address, cwd=tmp_path)
    local = run_alone("bc-train", "--name", "here", *TRAINING, *epochs, cwd=tmp_path)
    assert (resumed.returncode, local.returncode) == (0, 0), resumed.stderr
    assert [*learnt, *epoch_lines(resumed.stdout)] == epoch_lines(local.stdout)
    assert weights(tmp_path / "runs/there") == weights(tmp_path / "runs/here")


@pytest.mark.long
def test_a_node_that_dies_in_the_middle_costs_nothing_of_a_training(tmp_path: Path) -> None:
    epochs = 30
    with ray_cluster(nodes=0) as cluster:
        dying = cluster.add_node(num_cpus=1, include_dashboard=False)
        with started_training(cluster, tmp_path, epochs) as training:
            cluster.remove_node(dying, allow_graceful=False)
            cluster.add_node(num_cpus=1, include_dashboard=False)
            assert training.join() == 0, training.stderr
    local = run_alone("bc-train", "--name", "here", *TRAINING, "--epochs", epochs, cwd=tmp_path)
    assert epoch_lines(training.stdout) == epoch_lines(local.stdout)
    assert weights(tmp_path / "runs/there") == weights(tmp_path / "runs/here")


def test_a_cluster_of_another_version_is_reported(tmp_path: Path, small_cluster: Any) -> None:
    drives(tmp_path / "sessions", sessions=1)
    arguments = ["bc-index", "--ray", small_cluster.address]
    code = f"import sys, ray; ray.__version__ = '2.0.0'; sys.argv = {arguments}\n"
    done = run_code(f"{code}from behavioural_cloning_toolkit import bc_index; bc_index()", cwd=tmp_path)
    assert done.returncode == 1
    import ray

    assert f"the cluster has Ray {ray.__version__} and Python" in one_line_of(done)
    assert "this machine Ray 2.0.0" in one_line_of(done)
    assert not (tmp_path / "index").exists()


@pytest.mark.long
def test_calls_in_shared_tasks_have_their_results_and_one_error(cluster: Any) -> None:
    def half(number: int) -> int:
        if number % 2:
            raise UserError(f"{number}: an even number was expected")
        return number // 2

    with cluster_tasks(cluster.address) as tasks:
        halves = dict(tasks(half, [(2 * number,) for number in range(4_001)]))
        with pytest.raises(UserError, match="17: an even number was expected"):
            list(tasks(half, [(2 * number + (number == 8),) for number in range(4_001)]))
    assert halves == {number: number for number in range(4_001)}


def test_calls_have_the_cores_and_gpus_that_they_need_or_are_refused(cluster: Any) -> None:
    def assigned_gpus() -> list[str]:
        import ray

        ids: list[str] = ray.get_runtime_context().get_accelerator_ids()["GPU"]
        return ids

    no_gpu = pytest.raises(ClusterError, match="no node of the cluster has a GPU; give --device cpu")
    with no_gpu, cluster_tasks(cluster.address, gpus=1):
        pass
    too_few = pytest.raises(ClusterError, match=r"no node of the cluster has 2 cores, .* give --threads 1")
    with too_few, cluster_tasks(cluster.address, gpus=None, cpus=2):
        pass
    node = cluster.add_node(num_cpus=2, num_gpus=1, include_dashboard=False)
    try:
        with cluster_tasks(cluster.address, gpus=1) as tasks:
            assert dict(tasks(assigned_gpus, [(), ()])) == {0: ["0"], 1: ["0"]}
        with cluster_tasks(cluster.address, gpus=None, cpus=2) as tasks:  # one, if there is one
            assert dict(tasks(assigned_gpus, [()])) == {0: ["0"]}
        with cluster_tasks(cluster.address) as tasks:
            assert dict(tasks(assigned_gpus, [()])) == {0: []}
    finally:
        cluster.remove_node(node)


@pytest.mark.long
def test_a_node_without_the_toolkit_is_reported(tmp_path: Path) -> None:
    drives(tmp_path / "sessions", sessions=2)
    venv.create(tmp_path / "bare", with_pip=False)
    packages = next((tmp_path / "bare").rglob("site-packages"))
    (packages / "others.pth").write_text(sysconfig.get_path("purelib"))  # all that is installed beside the toolkit
    without = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    ray = "import sys; from ray.scripts.scripts import main; sys.argv[0] = 'ray'; main()"
    with ray_cluster(nodes=0) as cluster:
        start = [str(tmp_path / "bare" / "bin" / "python"), "-c", ray, "start", "--num-cpus", "1"]
        subprocess.run([*start, "--address", cluster.address], check=True, capture_output=True, env=without)
        done = run_alone("bc-index", "--ray", cluster.address, cwd=tmp_path)
    assert "cannot import dataset: every node needs behavioural-cloning-toolkit[scale]" in one_line_of(done)
    assert done.returncode == 1


@pytest.mark.parametrize("scheme", ["", pytest.param("ray://", marks=pytest.mark.long)])
def test_an_address_that_does_not_answer_is_reported_soon(tmp_path: Path, scheme: str) -> None:
    drives(tmp_path / "sessions", sessions=1)
    with socket.create_server(("127.0.0.1", 0)) as mute:
        address = f"{scheme}127.0.0.1:{mute.getsockname()[1]}"
        done = run_alone("bc-index", "--ray", address, cwd=tmp_path)
    assert one_line_of(done) == (
        f"bc-index: --ray {address}: the cluster cannot be reached (no answer); run `ray status` on its head"
    )
    assert done.returncode == 1


def test_a_cluster_with_a_token_that_is_not_here_is_reported(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RAY_AUTH_MODE", "token")
    monkeypatch.setenv("HOME", str(tmp_path))
    drives(tmp_path / "sessions", sessions=1)
    settings = b"\x00\x00\x00\x04" + bytes(5)  # with which every gRPC server answers
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer() -> None:
            with server.accept()[0] as stream:
                stream.sendall(settings)
                stream.recv(100)

        address = f"127.0.0.1:{server.getsockname()[1]}"
        with ThreadPoolExecutor() as other:
            other.submit(answer)
            # a process of its own: in one that Ray has been in, it does not look for a token again, and waits
            done = run_alone("bc-index", "--ray", address, cwd=tmp_path)
    assert "no token: run `ray get-auth-token` on" in one_line_of(done)
    assert done.returncode == 1


def test_the_message_of_a_dead_node_is_one_line_on_stderr(capsys: pytest.CaptureFixture[str]) -> None:
    dump = "".join(f"\n    [state-dump] line {number}" for number in range(36))
    print_node_message(
        {"lines": [f"[state-dump] x\nRaylet is terminated: 7{dump}"], "pid": "raylet", "is_err": False}
    )
    shown = capsys.readouterr()
    assert (shown.out, shown.err) == ("", "--ray: Raylet is terminated: 7\n")


def test_an_address_where_nothing_or_something_else_listens_is_reported() -> None:
    gone = f"127.0.0.1:{free_ports(1)[0]}"
    with pytest.raises(ClusterError, match=f"--ray {gone}: the cluster cannot be reached"), cluster_tasks(gone):
        pass
    is_told = pytest.raises(ClusterError, match="another program than Ray listens on this port")
    with serving_pages() as page, is_told, cluster_tasks(page):
        pass


@pytest.mark.long
def test_drives_on_a_cluster_have_the_numbers_of_drives_one_by_one(tmp_path: Path, cluster: Any) -> None:
    untrained_run(tmp_path / "runs" / "untrained")
    drives = ["drive", "--tracks", "lake", "--speed", 8, 12, "--laps", 0.002, "--json"]
    local = run_alone("bc-eval", *drives, "--drives", "here", cwd=tmp_path)
    remote = run_alone("bc-eval", *drives, "--drives", "there", "--ray", cluster.address, cwd=tmp_path)
    assert (local.returncode, remote.returncode) == (0, 0), remote.stderr
    # how far it is, where that takes long
    assert all(line.startswith("driving: ") for line in remote.stderr.splitlines()), remote.stderr
    expected = [line.replace('"here/', '"there/') for line in local.stdout.splitlines()]
    assert sorted(remote.stdout.splitlines()) == sorted(expected)
    assert all("trajectory_sha256" in line for line in expected)
    assert len(list((tmp_path / "there").glob("*.mcap"))) == 2


def test_the_example_of_a_cluster_is_one_by_rays_own_schema() -> None:
    import ray.autoscaler

    schema = json.loads((Path(ray.autoscaler.__path__[0]) / "ray-schema.json").read_text())
    example = yaml.safe_load((ROOT / "docs" / "ray-cluster.yaml").read_text())
    jsonschema.validate(example, schema)
    assert example["head_node_type"] in example["available_node_types"]
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({**example, "max_worker": 1}, schema)


@pytest.mark.long
def test_logs_in_a_bucket_are_indexed_by_a_cluster_of_this_machine(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("BC_CACHE", str(tmp_path / "cache"))
    monkeypatch.setenv("RAY_AUTH_TOKEN", "a" * 64)  # else Ray would leave one in ~/.ray
    with serving_bucket(tmp_path / "server", monkeypatch) as bucket:
        drives(bucket.folder, sessions=3)
        local = run_alone("bc-index", "--sessions", bucket.url(), "--index", "here", cwd=tmp_path)
        remote = run_alone(
            "bc-index", "--sessions", bucket.url(), "--index", "there", "--ray", "local", cwd=tmp_path
        )
    assert (local.returncode, remote.returncode) == (0, 0), remote.stderr
    assert index_files(tmp_path / "there") == index_files(tmp_path / "here")
