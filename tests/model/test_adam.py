"""The optimizer does what PyTorch's own Adam does, without loading PyTorch's compiler."""

from __future__ import annotations

import pytest
import torch
from torch import nn
from torch.nn import functional

from model.adam import Adam


def network() -> nn.Sequential:
    """Two layers, and a third that no loss depends on."""
    torch.manual_seed(3)
    layers = nn.Sequential(nn.Conv2d(3, 4, 3), nn.Linear(6, 1), nn.Linear(2, 2))
    layers.to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    return layers


def loss_of(layers: nn.Sequential, step: int) -> torch.Tensor:
    pictures = torch.sin(torch.arange(2 * 3 * 8 * 8) * (step + 1.0)).reshape(2, 3, 8, 8)
    return functional.mse_loss(layers[1](torch.relu(layers[0](pictures))), torch.full((2, 4, 6, 1), 0.5))


@pytest.mark.parametrize("device", ["cpu", pytest.param("cuda", marks=pytest.mark.needs("gpu"))])
def test_weights_and_moments_are_those_of_pytorchs_own_bit_for_bit(device: str) -> None:
    ours, theirs = network().to(device), network().to(device)
    adam = Adam(ours.parameters(), 1e-2)
    reference = torch.optim.Adam(theirs.parameters(), 1e-2, fused=device == "cuda")
    for step in range(5):
        for layers, optimizer in ((ours, adam), (theirs, reference)):
            optimizer.zero_grad()
            loss_of(layers, step).backward()  # type: ignore[no-untyped-call]
            optimizer.step()
    for parameter, other in zip(ours.parameters(), theirs.parameters(), strict=True):
        assert torch.equal(parameter, other)
        state, expected = adam.state.get(parameter, {}), reference.state.get(other, {})
        assert state.keys() == expected.keys()
        for name, tensor in state.items():
            assert torch.equal(tensor, expected[name])
            assert (tensor.stride(), tensor.dtype) == (expected[name].stride(), expected[name].dtype)
            assert tensor.device == expected[name].device
