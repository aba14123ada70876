"""torchvision's ResNet-18 (He et al. 2015, arXiv 1512.03385), with one answer, and random weights.

torchvision is an extra (`pip install ".[torchvision]"`) and is imported only here.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, Final

import torch
from torch import Tensor, nn

from common.versions import install_line
from dataset.picture_spec import PictureSpec
from model.errors import RunError
from model.network.picture_network import PictureNetwork

_OPERATORS: Final = {
    "torchvision::nms": "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor",
    "torchvision::qnms": "(Tensor dets, Tensor scores, float iou_threshold) -> Tensor",
}
"""Operators of its own that the import of torchvision cannot do without."""


class ResNet18(PictureNetwork):
    """RGB pictures (N, 3, 128, 128) to steering (N,). Raises RunError where there is no torchvision."""

    PICTURE = PictureSpec(channels="RGB")

    def __init__(self, outputs: int = 1) -> None:
        super().__init__()
        self.network = _torchvision_resnet18()(num_classes=outputs)

    def answers(self, inputs: Tensor) -> Tensor:
        answers: Tensor = self.network(inputs)
        return answers


def _torchvision_resnet18() -> Callable[..., nn.Module]:
    try:
        try:
            models: Any = importlib.import_module("torchvision.models")
        except RuntimeError:
            # Built for another PyTorch (with or without CUDA): its operators cannot be loaded. ResNet needs none
            # of them; once their names are defined, the rest of torchvision is imported.
            for name, schema in _OPERATORS.items():
                torch.library.define(name, schema)
            models = importlib.import_module("torchvision.models")
    except (ImportError, RuntimeError) as error:
        raise RunError(
            f"resnet18 needs torchvision ({error}): `{install_line('torchvision')}` brings it"
        ) from None
    made: Callable[..., nn.Module] = models.resnet18
    return made
