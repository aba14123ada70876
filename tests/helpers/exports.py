"""PyTorch's export of a network to ONNX, which takes seconds: made once for equal layers in a test process."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from onnx import ModelProto, numpy_helper

from dataset.picture_spec import PictureSpec
from dataset.prediction_targets import TargetName
from model import onnx_export
from model.network.picture_network import PictureNetwork

export = onnx_export._exported
_made: dict[tuple[Any, ...], bytes] = {}


def export_once(
    network: PictureNetwork, picture: PictureSpec, targets: Sequence[TargetName], of_camera: bool
) -> ModelProto:
    """As `export`: an earlier export of the same layers, with this network's weights. The exporter leaves out
    weights that are all zero."""
    weights = {f"network.{name}": tensor.numpy() for name, tensor in network.state_dict().items()}
    written = [name for name, values in weights.items() if values.any()]
    layers = (*map(type, network.modules()), repr(network), network.standardized, network.natural, *written)
    key = (layers, picture, *targets, of_camera)
    if key not in _made:
        _made[key] = export(network, picture, targets, of_camera).SerializeToString()
    model = ModelProto.FromString(_made[key])
    for initializer in model.graph.initializer:
        if initializer.name in weights:
            initializer.CopyFrom(numpy_helper.from_array(weights[initializer.name], initializer.name))
    return model
