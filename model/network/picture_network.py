"""The base class of all networks: pictures in, steering and other targets out.

Only this file scales pictures and checks the shape of answers.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar, Final

import torch
from torch import Tensor, nn

from common.errors import counted
from dataset.picture_spec import ORIGINAL, PictureSpec
from model.errors import RunError

_FLAT: Final = 0.05  # added to deviations: the noise of a picture of one colour stays small


class PictureNetwork(nn.Module):
    """Pictures (N, 3, height, width), uint8 or float 0..255, to steering (N,): -1 left .. 1 right, unclamped.

    With several targets, the answers are (N, outputs), steering first (`dataset.prediction_targets`).
    """

    PICTURE: ClassVar[PictureSpec] = ORIGINAL
    """The default picture; a run may have another."""

    outputs: int = 1
    """Number of targets that the network answers."""

    natural: Callable[[Tensor], Tensor] | None = None
    """Converts learnt steering to the network's answer; None during training, and if both are equal."""

    input_dtype = torch.float32
    """The dtype of the layers' inputs. Scaling is always in float32."""

    def __init__(self, standardized: bool = False) -> None:
        """`standardized` scales each colour of a picture to mean 0 and deviation 1: the light of the day no longer
        matters."""
        super().__init__()
        self.standardized = standardized

    def answers(self, inputs: Tensor) -> Tensor:
        """(N, outputs), or (N,) for one output, for pictures (N, 3, height, width) that are scaled to -1..1, or
        `standardized`."""
        raise NotImplementedError

    def forward(self, pictures: Tensor) -> Tensor:
        inputs = scaled(pictures)
        if self.standardized:
            inputs = standardized(inputs)
        learnt = targets_of(self.answers(inputs.to(self.input_dtype)), pictures.shape[0], self.outputs)
        if self.natural is None:
            return learnt
        if self.outputs == 1:
            return self.natural(learnt.float())
        learnt = learnt.float()
        return torch.cat([self.natural(learnt[:, :1]), learnt[:, 1:]], dim=1)


class LayerChain(PictureNetwork):
    """Convolutions `features`, then fully connected layers `head`."""

    features: nn.Sequential
    head: nn.Sequential

    def answers(self, inputs: Tensor) -> Tensor:
        answers: Tensor = self.head(self.features(inputs))
        return answers


def scaled(pictures: Tensor) -> Tensor:
    """Pictures, uint8 or float 0..255, as float32 -1..1."""
    return pictures.to(torch.float32) / 127.5 - 1.0


def standardized(pictures: Tensor) -> Tensor:
    """Pictures (N, 3, height, width) with mean 0 and deviation 1 of each colour. A picture of nearly one colour
    stays so."""
    centred = pictures - _mean(pictures)
    return centred * (1 / (_mean(centred.square()).sqrt() + _FLAT))


def _mean(pictures: Tensor) -> Tensor:
    # in two steps, the second much smaller: in channels_last memory, half of the time of torch.var_mean
    return pictures.mean(2, keepdim=True).mean(3, keepdim=True)


def targets_of(answers: Tensor, pictures: int, outputs: int = 1) -> Tensor:
    """A network's answers to `pictures` pictures as steering (N,), or as targets (N, outputs). Raises RunError for
    answers of another shape or type."""
    if isinstance(answers, Tensor) and answers.is_floating_point():
        if answers.shape == (pictures, outputs):
            return answers.squeeze(1) if outputs == 1 else answers
        if answers.shape == (pictures,) and outputs == 1:
            return answers
    shape = tuple(answers.shape) if isinstance(answers, Tensor) else type(answers).__name__
    kind = f" of {answers.dtype}" if isinstance(answers, Tensor) else ""
    if outputs == 1:
        expected = f"expected one number for each, ({pictures}, 1) or ({pictures},)"
    else:
        expected = f"expected one number for each and each target, ({pictures}, {outputs})"
    raise RunError(f"the network answers {shape}{kind} to {counted(pictures, 'picture')}: {expected}")


def glorot_weights(network: nn.Module) -> None:
    """Initial weights after Glorot and Bengio 2010, as in Keras, which the original project used.

    PyTorch's default weights are smaller: with them, a network answers nearly the same to every picture in the
    whole first epoch.
    """
    for layer in network.modules():
        if isinstance(layer, nn.Conv2d | nn.Linear):
            nn.init.xavier_uniform_(layer.weight)
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]
