"""What is in an .rrd file, as Rerun's own reader sees it, and where a viewer listens."""

from __future__ import annotations

import contextlib
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import psutil  # type: ignore[import-untyped]  # comes with rerun-sdk
import pyarrow as pa
from rerun.chunk import RrdReader


def contents(rrd: Path) -> dict[str, dict[str, list[Any]]]:
    """Values by entity and column, in the order of time."""
    reader = RrdReader(rrd)
    result: dict[str, dict[str, list[Any]]] = {}
    for chunk in reader.stream().to_chunks():
        batch = chunk.to_record_batch()
        entity = result.setdefault(str(chunk.entity_path), {})
        for name in batch.schema.names:
            values = batch.column(name)
            in_ns = values.cast("int64") if pa.types.is_timestamp(values.type) else values
            entity.setdefault(name, []).extend(in_ns.to_pylist())
    for columns in result.values():
        times = columns.get("message_log_time", [])
        for name, values in columns.items():
            if len(values) == len(times) and name != "message_log_time":
                columns[name] = [values[i] for i in np.argsort(np.array(times), kind="stable")]
        times.sort()
    return result


def arrived(rrd: Path, entity: str, column: str) -> int:
    """How many values of a column are in a file that is still being written."""
    with contextlib.suppress(OSError, RuntimeError, ValueError), warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it has no end yet
        return len([value for value in contents(rrd).get(entity, {}).get(column, []) if value is not None])
    return 0


def view_names(rrd: Path) -> set[str]:
    """The names of the views in its only layout."""
    reader = RrdReader(rrd)
    (blueprint,) = reader.blueprints()
    names: set[str] = set()
    for chunk in reader.stream(store=blueprint).to_chunks():
        batch = chunk.to_record_batch()
        if "ViewBlueprint:display_name" in batch.schema.names:
            names.update(value[0] for value in batch.column("ViewBlueprint:display_name").to_pylist() if value)
    return names


def listening(process: psutil.Process) -> dict[int, str]:
    """Address by port of what a process listens on; of one that has ended, nothing."""
    with contextlib.suppress(psutil.NoSuchProcess):
        return {
            connection.laddr.port: connection.laddr.ip
            for connection in process.net_connections("tcp")
            if connection.status == psutil.CONN_LISTEN
        }
    return {}


def lives(process: psutil.Process) -> bool:
    """A killed process whose parent is dead may stay in the list until the system has tidied up."""
    try:
        return bool(process.status() != psutil.STATUS_ZOMBIE)
    except psutil.NoSuchProcess:
        return False
