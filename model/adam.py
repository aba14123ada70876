"""The optimizer Adam of Kingma and Ba 2015 (arXiv 1412.6980), with its usual moments.

Arithmetic and names of the state are PyTorch's. But the first step of `torch.optim.Adam` loads PyTorch's compiler,
which the toolkit does not use: over a second in every training.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from torch import Tensor
from torch.optim.adam import adam


class Adam:
    """Updates parameters, which must be on one device, with the learning rate `rate`."""

    def __init__(self, parameters: Iterable[Tensor], rate: float) -> None:
        self.parameters = list(parameters)
        self.rate = rate
        self.is_fused = self.parameters[0].is_cuda
        self.state: dict[Tensor, dict[str, Tensor]] = {}
        """For each updated parameter `exp_avg` and `exp_avg_sq`, in its shape and memory format, and the step
        count `step`, a float32, on the same GPU or on the CPU."""

    def zero_grad(self) -> None:
        for parameter in self.parameters:
            parameter.grad = None

    @torch.no_grad()
    def step(self) -> None:
        """Update every parameter that has a gradient."""
        gradients = {parameter: parameter.grad for parameter in self.parameters if parameter.grad is not None}
        for parameter in gradients:
            if parameter not in self.state:
                self.state[parameter] = {
                    "step": torch.zeros((), device=parameter.device if self.is_fused else None),
                    "exp_avg": torch.zeros_like(parameter),
                    "exp_avg_sq": torch.zeros_like(parameter),
                }
        states = [self.state[parameter] for parameter in gradients]
        adam(
            list(gradients),
            list(gradients.values()),
            [state["exp_avg"] for state in states],
            [state["exp_avg_sq"] for state in states],
            [],
            [state["step"] for state in states],
            foreach=not self.is_fused,  # on a CPU, too: the same bits in two thirds of the time
            fused=self.is_fused,
            amsgrad=False,
            beta1=0.9,
            beta2=0.999,
            lr=self.rate,
            weight_decay=0,
            eps=1e-8,
            maximize=False,
        )
