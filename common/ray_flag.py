"""The flag `--ray [ADDRESS]`: calls are made one by one without it, by a cluster with it."""

from __future__ import annotations

import contextlib
from typing import Annotated

import tyro

from common.tasks import Tasks, one_by_one

RayAddress = Annotated[
    tuple[str, ...] | None, tyro.conf.arg(metavar="[ADDRESS]", help_behavior_hint="(default: none)")
]
"""The flag `--ray [ADDRESS]`: None where it is not given, empty where no address is."""


def tasks_of(ray: RayAddress) -> contextlib.AbstractContextManager[Tasks]:
    """The way to make calls that `--ray` chooses: one by one without it. Raises UsageError for an address that is
    none, ClusterError where no cluster can be reached."""
    if ray is None:
        return contextlib.nullcontext(one_by_one)
    from common.ray_cluster import address_of, cluster_tasks

    return cluster_tasks(address_of(ray))
