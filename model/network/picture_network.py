"""What every network here is: pictures in, steering out. Scaling and the answers' shape are in this one place."""

from __future__ import annotations

from collections.abc import Callable
from typing import ClassVar

import torch
from torch import Tensor, nn

from common.errors import counted
from dataset.picture_spec import ORIGINAL, PictureSpec
from model.errors import RunError


class PictureNetwork(nn.Module):
    """Pictures (N, 3, height, width), uint8 or float 0..255, to steering (N,): -1 left .. 1 right, unclamped."""

    PICTURE: ClassVar[PictureSpec] = ORIGINAL
    """What it sees, unless the run says otherwise."""

    natural: Callable[[Tensor], Tensor] | None = None
    """From what was learnt to the network's answer; None while it learns, and where both are the same."""

    input_dtype = torch.float32
    """What its layers are given. Scaling is always done in float32."""

    def answers(self, inputs: Tensor) -> Tensor:
        """(N, 1) or (N,) for pictures (N, 3, height, width) that are scaled to -1..1."""
        raise NotImplementedError

    def forward(self, pictures: Tensor) -> Tensor:
        learnt = steering_of(self.answers(scaled(pictures).to(self.input_dtype)), len(pictures))
        return learnt if self.natural is None else self.natural(learnt.float())


def scaled(pictures: Tensor) -> Tensor:
    """Pictures, uint8 or float 0..255, as float32 -1..1."""
    return pictures.to(torch.float32) / 127.5 - 1.0


def steering_of(answers: Tensor, pictures: int) -> Tensor:
    """The steering (N,) in what a network answers to so many pictures. Raises RunError for what is none."""
    if isinstance(answers, Tensor) and answers.is_floating_point():
        if answers.shape == (pictures, 1):
            return answers.squeeze(1)
        if answers.shape == (pictures,):
            return answers
    given = tuple(answers.shape) if isinstance(answers, Tensor) else type(answers).__name__
    kind = f" of {answers.dtype}" if isinstance(answers, Tensor) else ""
    raise RunError(
        f"the network answers {given}{kind} to {counted(pictures, 'picture')}: one number for each was expected,"
        f" ({pictures}, 1) or ({pictures},)"
    )


def glorot_weights(network: nn.Module) -> None:
    """Initial weights after Glorot and Bengio 2010, as in Keras, which the original used.

    With PyTorch's own, smaller weights a network answers nearly the same to every picture for the whole first
    epoch.
    """
    for layer in network.modules():
        if isinstance(layer, nn.Conv2d | nn.Linear):
            nn.init.xavier_uniform_(layer.weight)
            nn.init.zeros_(layer.bias)  # type: ignore[arg-type]
