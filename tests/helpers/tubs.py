"""Small DonkeyCar tubs, written as DonkeyCar writes them.

Version 2 after donkeycar/parts/tub_v2.py and datastore_v2.py of release 5, version 1 after
donkeycar/parts/datastore.py of release 3.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from pathlib import Path

import cv2
import numpy as np

INPUTS = ["cam/image_array", "user/angle", "user/throttle", "user/mode"]
TYPES = ["image_array", "float", "float", "str"]
CREATED_S = 1_679_574_289.75
FIRST_MS = 1_679_574_357_691
CATALOG_LENGTH = 3  # 1000 in DonkeyCar

# angle, throttle: as driven
VALUES = [(-1.0, 0.5), (0.0, 0.0), (0.25, -0.5571428571428572), (1.0, 1.0)]

Record = dict[str, object]


def jpeg(number: int) -> bytes:
    """A picture of DonkeyCar's size, 160x120; every number gives another one."""
    picture = np.full((120, 160, 3), 40 + 13 * number % 180, np.uint8)
    cv2.putText(picture, str(number), (20, 80), cv2.FONT_HERSHEY_SIMPLEX, 2.0, (0, 200, 255), 3)
    ok, encoded = cv2.imencode(".jpg", picture)
    assert ok
    return encoded.tobytes()


def name_2(index: int) -> str:
    return f"{index}_cam_image_array_.jpg"


def name_1(index: int) -> str:
    return f"{index}_cam-image_array_.jpg"


def record_2(index: int, **changes: object) -> Record:
    """A record of a version 2 tub, driven by a person; its values repeat every four records."""
    angle, throttle = VALUES[index % len(VALUES)]
    record: Record = {
        "_index": index,
        "_session_id": "23-03-23_0",
        "_timestamp_ms": FIRST_MS + 50 * index,
        "cam/image_array": name_2(index),
        "user/angle": angle,
        "user/mode": "user",
        "user/throttle": throttle,
    }
    return {**record, **changes}


def record_1(index: int, **changes: object) -> Record:
    """A record of a version 1 tub, driven by a person."""
    angle, throttle = VALUES[index % len(VALUES)]
    record: Record = {
        "cam/image_array": name_1(index),
        "user/angle": angle,
        "user/throttle": throttle,
        "user/mode": "user",
        "milliseconds": 100 + 50 * index,
    }
    return {**record, **changes}


def write_tub_2(
    folder: Path,
    records: Iterable[Record | bytes],
    *,
    deleted: Iterable[int] = (),
    pictures: Iterable[int] = range(4),
    line_end: bytes = b"\r\n",
) -> Path:
    """A version 2 tub; records that are bytes are written as they are."""
    (folder / "images").mkdir(parents=True)
    for index in pictures:
        (folder / "images" / name_2(index)).write_bytes(jpeg(index))
    lines = [
        line if isinstance(line, bytes) else json.dumps(line, sort_keys=True).encode() + line_end
        for line in records
    ]
    catalogs = [lines[at : at + CATALOG_LENGTH] for at in range(0, len(lines), CATALOG_LENGTH)]
    for number, catalog in enumerate(catalogs):
        (folder / f"catalog_{number}.catalog").write_bytes(b"".join(catalog))
        about = {
            "created_at": CREATED_S,
            "line_lengths": [len(line) for line in catalog],
            "path": f"catalog_{number}.catalog_manifest",
            "start_index": number * CATALOG_LENGTH,
        }
        (folder / f"catalog_{number}.catalog_manifest").write_text(json.dumps(about))
    session = {"all_full_ids": ["23-03-23_0"], "last_id": 0, "last_full_id": "23-03-23_0"}
    manifest: list[object] = [
        INPUTS,
        TYPES,
        {},
        {"created_at": CREATED_S, "sessions": session},
        {
            "paths": [f"catalog_{number}.catalog" for number in range(len(catalogs))],
            "current_index": len(lines),
            "max_len": CATALOG_LENGTH,
            "deleted_indexes": list(deleted),
        },
    ]
    (folder / "manifest.json").write_bytes(b"".join(json.dumps(line).encode() + line_end for line in manifest))
    return folder


def write_tub_1(
    folder: Path,
    records: Mapping[int, Record | bytes],
    *,
    start_s: float | None = CREATED_S,
    pictures: Iterable[int] = range(4),
) -> Path:
    """A version 1 tub: records by their number; those that are bytes are written as they are."""
    folder.mkdir(parents=True)
    meta = {"inputs": INPUTS, "types": TYPES, **({} if start_s is None else {"start": start_s})}
    (folder / "meta.json").write_text(json.dumps(meta))
    for index in pictures:
        (folder / name_1(index)).write_bytes(jpeg(index))
    for index, record in records.items():
        data = record if isinstance(record, bytes) else json.dumps(record).encode()
        (folder / f"record_{index}.json").write_bytes(data)
    return folder
