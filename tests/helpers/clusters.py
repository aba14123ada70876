"""A Ray cluster of several nodes on this machine, for the tests of what is done on one."""

from __future__ import annotations

import contextlib
import os
import warnings
from collections.abc import Iterator
from typing import Any
from unittest import mock


@contextlib.contextmanager
def ray_cluster(nodes: int = 2, head_processors: int = 0) -> Iterator[Any]:
    """A `ray.cluster_utils.Cluster`: a head, which runs no task without processors, and so many nodes with one
    processor each."""
    environment = {
        "RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO": "0",
        "RAY_USAGE_STATS_ENABLED": "0",
        "RAY_worker_niceness": "0",
    }
    with mock.patch.dict(os.environ, environment), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        from ray.cluster_utils import Cluster

        head = {"num_cpus": head_processors, "include_dashboard": False}
        cluster = Cluster(initialize_head=True, head_node_args=head)
        try:
            for _ in range(nodes):
                cluster.add_node(num_cpus=1, include_dashboard=False)
            yield cluster
        finally:
            cluster.shutdown()
