"""torchvision's ResNet-18 (He et al. 2015, arXiv 1512.03385), with one answer, and random weights.

torchvision is an extra (`pip install "behavioural-cloning-toolkit[torchvision]"`) and is imported only here.
"""

from __future__ import annotations

from torch import Tensor

from common.versions import TOOLKIT
from dataset.picture_spec import PictureSpec
from model.errors import RunError
from model.network.picture_network import PictureNetwork


class ResNet18(PictureNetwork):
    """RGB pictures (N, 3, 128, 128) to steering (N,). Raises RunError where there is no torchvision."""

    PICTURE = PictureSpec(channels="RGB")

    def __init__(self) -> None:
        super().__init__()
        try:
            from torchvision.models import resnet18
        except (ImportError, RuntimeError) as error:  # a RuntimeError: it was built for another PyTorch
            raise RunError(
                f'resnet18 needs torchvision ({error}): `pip install "{TOOLKIT}[torchvision]"` brings it'
            ) from None
        self.network = resnet18(num_classes=1)

    def answers(self, inputs: Tensor) -> Tensor:
        steering: Tensor = self.network(inputs)
        return steering
