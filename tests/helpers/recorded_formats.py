"""The same rows as a recording of each format."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, Final

from recorder.sources.settings import ImportSettings
from tests.helpers.lerobot_folders import write_dataset
from tests.helpers.other_logs import CAMERA, WHEEL, angle, image, write_mcap
from tests.helpers.tubs import FIRST_MS, name_2, record_2, write_tub_2

Row = tuple[float, float, bytes]  # seconds, steering, picture
Made = tuple[Path, ImportSettings]

COLUMNS: Final = ("image=p", "steering=s", "time_s=t")


def as_udacity(folder: Path, rows: Sequence[Row]) -> Made:
    (folder / "IMG").mkdir(parents=True)
    lines = []
    for time_s, steering, picture in rows:
        ms = round(time_s * 1000)
        name = f"center_2024_07_13_14_{30 + ms // 60_000:02d}_{ms // 1000 % 60:02d}_{ms % 1000:03d}.jpg"
        (folder / "IMG" / name).write_bytes(picture)
        lines.append(f"IMG/{name},,,{steering},0.5,0,9.5\n")
    (folder / "driving_log.csv").write_text("".join(lines))
    return folder, ImportSettings()


def as_csv(folder: Path, rows: Sequence[Row]) -> Made:
    folder.mkdir(parents=True)
    lines = ["p,s,t\n"]
    for number, (time_s, steering, picture) in enumerate(rows):
        (folder / f"{number}.jpg").write_bytes(picture)
        lines.append(f"{number}.jpg,{steering},{time_s}\n")
    (folder / "labels.csv").write_text("".join(lines))
    return folder, ImportSettings(columns=COLUMNS)


def as_tub(folder: Path, rows: Sequence[Row]) -> Made:
    records = [
        record_2(number, **{"_timestamp_ms": FIRST_MS + round(time_s * 1000), "user/angle": steering})
        for number, (time_s, steering, _) in enumerate(rows)
    ]
    write_tub_2(folder, records, pictures=range(len(rows)))
    for number, (_, _, picture) in enumerate(rows):
        (folder / "images" / name_2(number)).write_bytes(picture)
    return folder, ImportSettings()


def as_mcap(folder: Path, rows: Sequence[Row]) -> Made:
    folder.mkdir(parents=True)
    reported = [
        message
        for time_s, steering, picture in rows
        for message in ((WHEEL, time_s, angle(steering)), (CAMERA, time_s, image(picture)))
    ]
    source = write_mcap(folder / "other.mcap", reported)
    return source, ImportSettings(image=CAMERA, steering=f"{WHEEL}.steering.angle")


def as_lerobot(folder: Path, rows: Sequence[Row]) -> Made:
    features: dict[str, dict[str, Any]] = {
        "observation.images.front": {"dtype": "image", "shape": [160, 320, 3], "names": None},
        "action": {"dtype": "float32", "shape": [1], "names": ["steering"]},
    }
    columns: dict[str, Sequence[Any]] = {
        "observation.images.front": [{"bytes": picture, "path": None} for _, _, picture in rows],
        "action": [steering for _, steering, _ in rows],
    }
    write_dataset(folder, features, columns, [len(rows)])
    return folder, ImportSettings()


FORMATS: Final[dict[str, Callable[[Path, Sequence[Row]], Made]]] = {
    "Udacity": as_udacity,
    "csv": as_csv,
    "DonkeyCar": as_tub,
    "MCAP": as_mcap,
    "LeRobot": as_lerobot,
}
