"""The running mean of a network's weights over its last steps. The mean is measured and kept, and drives.

Each step of Adam follows the noise of its batch; the mean of many steps reduces this noise. Polyak and Juditsky
1992, "Acceleration of stochastic approximation by averaging"; as an exponential mean in Tarvainen and Valpola 2017
(arXiv 1703.01780).
"""

from __future__ import annotations

import copy
from typing import Final

import torch
from torch.optim.swa_utils import get_ema_multi_avg_fn

from model.network.picture_network import PictureNetwork

_FIRST_STEPS: Final = 10
"""After N steps, the mean is over at most 1 + N / 10 of them, so that the random initial weights are soon
forgotten."""


class AveragedWeights:
    """A second network, whose weights are the exponential mean of the first one's over about `steps` steps.

    With one step, it is the first network itself.
    """

    def __init__(self, network: PictureNetwork, steps: int) -> None:
        self._steps = steps
        self.network = network if steps == 1 else copy.deepcopy(network)

    @torch.no_grad()
    def begin(self, network: PictureNetwork) -> None:
        """Begin with the weights of `network`, before its first step."""
        self.network.load_state_dict(network.state_dict())

    def update(self, network: PictureNetwork, steps_taken: int) -> None:
        """Add the weights of `network` to the mean. `steps_taken` counts from 1, after the first step."""
        if self.network is not network:
            keep = 1 - max(1 / self._steps, 1 / (1 + steps_taken / _FIRST_STEPS))
            update = get_ema_multi_avg_fn(keep)  # type: ignore[no-untyped-call]
            update(list(self.network.parameters()), list(network.parameters()), steps_taken)
            for mean, latest in zip(self.network.buffers(), network.buffers(), strict=True):
                mean.copy_(latest)  # buffers of a batch normalisation are already means
