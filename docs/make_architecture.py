"""Writes the picture of ARCHITECTURE.md (`make docs`)."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Final

from generated_blocks import ROOT, update

PICTURE: Final = ROOT / "docs" / "pictures" / "architecture.svg"
ROOMS: Final = ("web", "drive", "viz", "model", "dataset", "recorder", "simulator", "common")


def main() -> None:
    update(PICTURE, picture())


def modules(room: str) -> Iterator[Path]:
    """The modules of a room, those of its folders last."""
    paths = (path for path in (ROOT / room).rglob("*.py") if path.name != "__init__.py")
    yield from sorted(paths, key=lambda path: (path.parent, path.name))


@dataclass(frozen=True)
class Box:
    column: int
    row: int
    name: str
    lines: tuple[str, ...]
    kind: str
    """`code` of this repository, a `file`, or something `outside`"""

    @property
    def left(self) -> int:
        return 16 + 200 * self.column

    @property
    def top(self) -> int:
        return 16 + 130 * self.row


WIDTH, HEIGHT = 152, 76
FILLS: Final = {"code": "#dbe7f6", "file": "#fbeecb", "outside": "#eeeeee"}
BOXES: Final = (
    Box(0, 0, "what was driven", ("Udacity folder, tub, bag,", "built-in simulator, live"), "outside"),
    Box(1, 0, "recorder/sources", ("rows, JPEGs as they are,", "through recorder/log"), "code"),
    Box(2, 0, "sessions/NAME.mcap", ("the log: pictures, vehicle,", "events, CRCs"), "file"),
    Box(3, 0, "dataset/index", ("byte ranges, labels,", "balance, split"), "code"),
    Box(4, 0, "index/*.parquet", ("one row a frame,", "one row a sample"), "file"),
    Box(4, 1, "dataset/loader", ("read, decode, augment,", "dataset/preprocessing.py"), "code"),
    Box(3, 1, "model/training", ("epochs, checkpoints,", "model/network"), "code"),
    Box(2, 1, "runs/NAME/", ("weights, settings, curves:", "model/runs"), "file"),
    Box(1, 1, "model/pilot.py", ("the same", "dataset/preprocessing.py"), "code"),
    Box(0, 2, "a simulator", ("over Socket.IO:", "recorder/server"), "outside"),
    Box(1, 2, "drive/control", ("telemetry to command:", "steering, speed, brake"), "code"),
    Box(2, 2, "drive/log", ("every telemetry, every", "answer, the summary"), "code"),
    Box(3, 2, "drives/DATE.mcap", ("a log again:", "to train on"), "file"),
    Box(4, 2, "viz", ("any log, any run,", "in Rerun or a video"), "code"),
)
LINES: Final = (  # each a list of corners; the arrow's head is at the end
    ((168, 54), (214, 54)),
    ((368, 54), (414, 54)),
    ((568, 54), (614, 54)),
    ((768, 54), (814, 54)),
    ((910, 92), (910, 144)),
    ((492, 92), (492, 118), (860, 118), (860, 144)),
    ((816, 184), (770, 184)),
    ((616, 184), (570, 184)),
    ((416, 184), (370, 184)),
    ((292, 222), (292, 274)),
    ((168, 304), (214, 304)),
    ((216, 326), (170, 326)),
    ((368, 314), (414, 314)),
    ((568, 314), (614, 314)),
    ((768, 314), (814, 314)),
    ((692, 276), (692, 248), (592, 248), (592, 56)),
)
LABELS: Final = (
    (676, 112, "pictures, by byte range"),
    (300, 252, "steering"),
    (170, 297, "telemetry"),
    (170, 340, "steer"),
    (598, 262, "every drive is data"),
)


def picture() -> str:
    """How a frame travels, as SVG."""
    shapes = [
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 984 368" font-family="Helvetica, sans-serif">',
        '<marker id="head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" orient="auto">'
        '<path d="M0 0 8 4 0 8z" fill="#444"/></marker>',
        '<rect width="984" height="368" fill="#fff"/>',
    ]
    for corners in LINES:
        path = "".join(f"L{x} {y}" for _, (x, y) in pairwise(corners))
        start = f"M{corners[0][0]} {corners[0][1]}"
        shapes.append(
            f'<path d="{start}{path}" fill="none" stroke="#444" stroke-width="1.5" marker-end="url(#head)"/>'
        )
    for box in BOXES:
        middle = box.left + WIDTH // 2
        radius = 14 if box.kind == "file" else 3
        shapes.append(
            f'<rect x="{box.left}" y="{box.top}" width="{WIDTH}" height="{HEIGHT}" rx="{radius}"'
            f' fill="{FILLS[box.kind]}" stroke="#444"/>'
        )
        shapes.append(_text(middle, box.top + 24, box.name, 13.5, "middle", "bold"))
        for number, line in enumerate(box.lines):
            shapes.append(_text(middle, box.top + 44 + 17 * number, line, 11.5, "middle"))
    shapes += [_text(x, y, label, 10.5) for x, y, label in LABELS]
    return "\n".join([*shapes, "</svg>", ""])


def _text(x: int, y: int, words: str, size: float, anchor: str = "start", weight: str = "normal") -> str:
    return (
        f'<text x="{x}" y="{y}" font-size="{size}" text-anchor="{anchor}" font-weight="{weight}" fill="#222">'
        f"{words}</text>"
    )


if __name__ == "__main__":
    main()
