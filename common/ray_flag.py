"""The flag `--ray [ADDRESS]`: with it, a cluster makes the calls; without it, this machine."""

from __future__ import annotations

import contextlib
from typing import Annotated

import tyro

from common.tasks import Tasks, one_by_one

RayAddress = Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="[ADDRESS]")]
"""The flag `--ray [ADDRESS]`: None without the flag, empty without an address."""


def tasks_of(ray: RayAddress, gpus: int = 0, here: Tasks = one_by_one) -> contextlib.AbstractContextManager[Tasks]:
    """A context manager that yields the `Tasks` that `--ray` chooses; on a cluster, each call has `gpus` GPUs to
    itself; without the flag, the tasks are made `here`. Raises UsageError for an invalid address, ClusterError if
    no cluster can be reached, or if it has no GPU."""
    if ray is None:
        return contextlib.nullcontext(here)
    from common.ray_cluster import address_of, cluster_tasks

    return cluster_tasks(address_of(ray), gpus)
