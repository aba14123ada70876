"""A step of the optimizer is the same in parts as at once, and in bfloat16 nearly what it is in float32."""

from __future__ import annotations

import copy
import functools

import pytest
import torch
from torch import nn
from torch.nn import functional

from model.adam import Adam
from model.network.original import SteeringNetwork
from model.training.step import training_step


@functools.cache
def gradients(dtype: torch.dtype, micro_batch: int, batch: int | None = None) -> tuple[float, torch.Tensor]:
    """The squared error of seven drawn samples, and the gradient of all weights in one."""
    torch.manual_seed(3)
    network = SteeringNetwork(dropout=0.0).to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    pictures = torch.randint(0, 256, (7, 3, 128, 128), dtype=torch.uint8)
    steering = torch.linspace(-1, 1, 7)
    optimizer = Adam(network.parameters(), 1e-4)
    error = training_step(
        network, optimizer, pictures, steering, dtype=dtype, micro_batch=micro_batch, batch=batch
    )
    return float(error), torch.cat([p.grad.ravel() for p in network.parameters() if p.grad is not None])


def test_the_gradient_is_that_of_the_mean_squared_error() -> None:
    torch.manual_seed(3)
    network = SteeringNetwork(dropout=0.0)
    pictures, steering = torch.randint(0, 256, (7, 3, 128, 128), dtype=torch.uint8), torch.linspace(-1, 1, 7)
    loss = functional.mse_loss(network(pictures), steering)
    loss.backward()  # type: ignore[no-untyped-call]
    expected = torch.cat([p.grad.ravel() for p in network.parameters() if p.grad is not None])
    error, gradient = gradients(torch.float32, 7)
    assert error == pytest.approx(7 * loss.item(), rel=1e-5)
    assert functional.cosine_similarity(gradient, expected, dim=0) > 0.99999
    assert float(gradient.norm() / expected.norm()) == pytest.approx(1, rel=1e-4)


@pytest.mark.parametrize("micro_batch", [3, 100])
def test_parts_of_a_batch_add_up(micro_batch: int) -> None:
    error, gradient = gradients(torch.float32, 7)
    in_parts, of_parts = gradients(torch.float32, micro_batch)
    assert in_parts == pytest.approx(error, rel=1e-5)
    torch.testing.assert_close(of_parts, gradient, rtol=1e-3, atol=1e-6)


def test_samples_that_do_not_decode_count_in_the_mean() -> None:
    _, seven = gradients(torch.float32, 7)
    _, of_fourteen = gradients(torch.float32, 7, batch=14)
    torch.testing.assert_close(of_fourteen * 2, seven, rtol=1e-5, atol=1e-8)


def test_bfloat16_is_close_and_keeps_weights_in_float32() -> None:
    exact, gradient = gradients(torch.float32, 7)
    error, rounded = gradients(torch.bfloat16, 3)
    assert error == pytest.approx(exact, rel=0.02)
    assert error != exact  # it was computed otherwise
    assert rounded.dtype == torch.float32
    assert functional.cosine_similarity(rounded, gradient, dim=0) > 0.95


def test_bfloat16_learns_what_pytorchs_own_layers_do_bit_for_bit() -> None:
    """Also where oneDNN pools, and the weights are cast once for all parts. In flat pictures maxima are ties."""
    torch.manual_seed(3)
    network = SteeringNetwork().to(memory_format=torch.channels_last)  # type: ignore[call-overload]
    plain = copy.deepcopy(network)
    plain.features = nn.Sequential(*plain.features)
    optimizer, reference = (
        Adam(network.parameters(), 1e-3),
        torch.optim.Adam(plain.parameters(), lr=1e-3, foreach=True),
    )
    pictures, steering = torch.randint(0, 256, (3, 3, 128, 128), dtype=torch.uint8), torch.linspace(-1, 1, 3)
    pictures[0] = 100
    for step in range(2):
        torch.manual_seed(step)  # of the dropout
        training_step(network, optimizer, pictures, steering, dtype=torch.bfloat16, micro_batch=2)
        torch.manual_seed(step)
        reference.zero_grad()
        for some, theirs in zip(torch.split(pictures, 2), torch.split(steering, 2), strict=True):
            with torch.autocast("cpu", dtype=torch.bfloat16):
                predicted = plain(some)
            (functional.mse_loss(predicted.float(), theirs, reduction="sum") / 3).backward()  # type: ignore[no-untyped-call]
        reference.step()
    for mine, other in zip(network.parameters(), plain.parameters(), strict=True):
        assert torch.equal(mine, other)
