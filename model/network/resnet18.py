"""torchvision's ResNet-18 (He et al. 2015, arXiv 1512.03385), with the targets as outputs, and random weights.

torchvision is an extra (`pip install ".[torchvision]"`). Only this file imports it.
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
"""torchvision's own operators that its import needs."""


class ResNet18(PictureNetwork):
    """RGB pictures (N, 3, 128, 128) to steering (N,), or (N, outputs). Raises RunError if torchvision is
    missing."""

    PICTURE = PictureSpec(channels="RGB")

    def __init__(self, outputs: int = 1, standardized: bool = False) -> None:
        super().__init__(standardized)
        self.network = _torchvision_resnet18()(num_classes=outputs)

    def answers(self, inputs: Tensor) -> Tensor:
        answers: Tensor = self.network(inputs)
        return answers


def _torchvision_resnet18() -> Callable[..., nn.Module]:
    try:
        try:
            models: Any = importlib.import_module("torchvision.models")
        except RuntimeError:
            # Built for another PyTorch (with or without CUDA), torchvision cannot load its operators. ResNet needs
            # none of them; with their names defined, the import works.
            for name, schema in _OPERATORS.items():
                torch.library.define(name, schema)
            models = importlib.import_module("torchvision.models")
    except (ImportError, RuntimeError) as error:
        raise RunError(
            f"resnet18 needs torchvision ({error}): install it with `{install_line('torchvision')}`"
        ) from None
    resnet18: Callable[..., nn.Module] = models.resnet18
    return resnet18
