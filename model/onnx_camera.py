"""The preprocessing of a camera's picture as nodes of an ONNX graph: crop, size and order of colours.

It does what `preprocess` of `dataset.preprocessing` does. OpenCV rounds its weights to 11 bits: levels may differ
by 1 of 255, by 2 in YUV.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from dataset.picture_spec import ROWS, PictureSpec

if TYPE_CHECKING:
    from model.onnx_graph import Graph

PICTURE, CROP = "picture", "crop"
LARGEST_DIFFERENCE: Final = {"BGR": 1, "RGB": 1, "YUV": 2}
"""Levels of 255 by which a crop may differ from that of training."""

# OpenCV's COLOR_RGB2YUV: luma of ITU-R BT.601, and its differences from blue and red
_LUMA: Final = np.array([0.299, 0.587, 0.114])
_YUV: Final = np.stack([_LUMA, 0.492 * (np.array([0, 0, 1]) - _LUMA), 0.877 * (np.array([1, 0, 0]) - _LUMA)])


def add_preprocessing(graph: Graph, spec: PictureSpec) -> str:
    """Add the nodes from "picture", uint8 (height, width, 3) RGB of any size, to "crop", uint8 of the network's
    shape and colours. The value of the crop's levels, float32 (1, 3, height, width)."""
    from onnx import TensorProto

    value = graph.add("Slice", "rows", PICTURE, *_row_range(graph, spec), graph.integers("row_axis", 0))
    value = graph.add("Transpose", "row_planes", value, perm=[2, 0, 1])
    value = graph.add("Unsqueeze", "one_picture", value, graph.integers("first_axis", 0))
    value = graph.add("Cast", "row_levels", value, to=TensorProto.FLOAT)
    size = graph.integers("size", 1, 3, spec.height_px, spec.width_px)
    value = graph.add(
        "Resize", "resized", value, "", "", size, mode="linear", coordinate_transformation_mode="half_pixel"
    )
    value = graph.add("Round", "levels", value)
    if spec.channels == "BGR":
        value = graph.add("Gather", "bgr", value, graph.integers("bgr_order", 2, 1, 0), axis=1)
    elif spec.channels == "YUV":
        weights = graph.constant("yuv_weights", _YUV[..., None, None].astype(np.float32))
        value = graph.add(
            "Conv", "yuv", value, weights, graph.constant("yuv_zero", np.array([0, 128, 128], np.float32))
        )
        value = graph.add(
            "Clip",
            "yuv_levels",
            graph.add("Round", "yuv_rounded", value),
            graph.constant("black", np.array(0, np.float32)),
            graph.constant("white", np.array(255, np.float32)),
        )
    crop = graph.add(
        "Transpose", "crop_levels", graph.add("Squeeze", "crop_planes", value, "first_axis"), perm=[1, 2, 0]
    )
    graph.add("Cast", CROP, crop, to=TensorProto.UINT8)
    return value


def _row_range(graph: Graph, spec: PictureSpec) -> tuple[str, str]:
    """The first row of the crop and the one after its last, each int64 (1,): `PictureSpec.crop_slice`."""
    from onnx import TensorProto

    height = graph.add("Gather", "height", graph.add("Shape", "shape", PICTURE), graph.integers("height_at", 0))
    exact = graph.add("Cast", "exact_height", height, to=TensorProto.DOUBLE)

    def rows_of(name: str, share: int) -> str:
        rows = graph.add("Mul", f"exact_{name}", exact, graph.constant(f"{name}_share", np.array([share / ROWS])))
        return graph.add("Cast", name, graph.add("Round", f"whole_{name}", rows), to=TensorProto.INT64)

    one_row = graph.integers("one_row", 1)
    last = graph.add("Sub", "last_row", height, one_row)
    first = graph.add("Min", "first_row", rows_of("rows_off_top", spec.crop_top), last)
    below = graph.add("Sub", "uncut_end", height, rows_of("rows_off_bottom", spec.crop_bottom))
    return first, graph.add("Max", "end_row", below, graph.add("Add", "least_end", first, one_row))
