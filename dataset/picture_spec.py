"""The specification of a network's input: the crop of the camera's picture, the size and the order of colours."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final, Literal, get_args

Channels = Literal["BGR", "RGB", "YUV"]

ROWS: Final = 160
"""The height of the simulator's pictures. Crops count these rows; of other pictures, the same share is cut off."""
MIN_PX, MAX_PX = 8, 1024


@dataclass(frozen=True)
class PictureSpec:
    """How a picture of any size is cropped, resized and converted. Defaults: the original project's.

    Raises ValueError if the result would be too small, too large or empty.
    """

    width_px: int = 128
    height_px: int = 128
    crop_top: int = 50  # of 160 rows: cuts off sky and trees
    crop_bottom: int = 20  # of 160 rows: cuts off the bonnet
    channels: Channels = "BGR"

    def __post_init__(self) -> None:
        for size in (self.width_px, self.height_px):
            if not MIN_PX <= size <= MAX_PX:
                raise ValueError(f"expected pictures of {MIN_PX} to {MAX_PX:,} px a side, not {size:,}")
        cut = self.crop_top + self.crop_bottom
        if min(self.crop_top, self.crop_bottom) < 0 or cut >= ROWS:
            raise ValueError(f"fewer than {ROWS} rows can be cut off, not {self.crop_top} and {self.crop_bottom}")
        if self.channels not in get_args(Channels):
            raise ValueError(f"expected one of the orders of colours {', '.join(get_args(Channels))}")

    @classmethod
    def from_description(cls, stored: Any) -> PictureSpec:
        """The input of a run, from its `description`. Raises ValueError if no version has written this."""
        names = ("width_px", "height_px", "crop_top", "crop_bottom")
        try:
            sizes = {name: int(stored[name].removesuffix(f"/{ROWS}")) for name in names}
            spec = cls(**sizes, channels=stored["channels"])
        except (AttributeError, KeyError, TypeError) as error:
            raise ValueError(f"no description of pictures: {error}") from None
        if spec.description != stored:
            raise ValueError(f"expected {spec.description}, not {stored!r:.400}")
        return spec

    @property
    def description(self) -> dict[str, str]:
        """The input as text values, which runs and logs of drives store."""
        return {
            "channels": self.channels,
            "crop_top": f"{self.crop_top}/{ROWS}",
            "crop_bottom": f"{self.crop_bottom}/{ROWS}",
            "height_px": str(self.height_px),
            "width_px": str(self.width_px),
            "resize": "bilinear",
        }

    @property
    def shape(self) -> tuple[int, int, int]:
        """(height, width, 3)."""
        return self.height_px, self.width_px, 3

    @property
    def size_bytes(self) -> int:
        return self.height_px * self.width_px * 3

    def crop_slice(self, height: int) -> slice:
        """The rows of a picture of this height that the crop keeps: at least one."""
        top = min(round(height * (self.crop_top / ROWS)), height - 1)
        return slice(top, max(height - round(height * (self.crop_bottom / ROWS)), top + 1))

    def __str__(self) -> str:
        rows = f"{self.crop_top} and {self.crop_bottom} of {ROWS} rows cut off"
        return f"{self.width_px} x {self.height_px} px {self.channels}, {rows}"


def metadata_of(picture: PictureSpec) -> dict[str, str]:
    """The entries that describe a network's input in the metadata of a log or an ONNX file."""
    return {f"preprocessing.{name}": value for name, value in picture.description.items()}


ORIGINAL: Final = PictureSpec()
"""The input of the original project's network, and of all runs of earlier versions."""
