"""A step of the optimizer is the same in parts as at once, with other layers and replayed, and nearly the same in
bfloat16."""

from __future__ import annotations

import contextlib
import copy
import functools
import re
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from torch import Tensor, nn
from torch.nn import functional

from model.adam import Adam
from model.device import Machine
from model.network.faster_layers import FasterLayers
from model.network.pilotnet import SmallNetwork, SteeringNetwork
from model.network.replayed import record
from model.training.step import TrainingSteps, training_step


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


@pytest.mark.parametrize("dtype", [torch.float32, torch.bfloat16])
def test_a_step_keeps_no_part_of_its_gradient_for_the_next(dtype: torch.dtype) -> None:
    """A kept node would stay on the stream of the step that made it, and the recording of the next step would
    fail (pytorch/pytorch#64339)."""
    torch.manual_seed(3)
    network = SmallNetwork(outputs=2)
    network.outputs = 2

    def nodes() -> list[Any]:
        """For each weight, the node that adds up its gradient."""
        views: list[Any] = [parameter.view_as(parameter) for parameter in network.parameters()]
        return [view.grad_fn.next_functions[0][0] for view in views]

    def mark(*arguments: object) -> None:
        for node in nodes():
            node.metadata["marked"] = True
        assert all(node.metadata for node in nodes())  # the same nodes, while the gradient needs them

    network.register_forward_hook(mark)
    height, width, _ = SmallNetwork.PICTURE.shape
    pictures, labels = torch.zeros((3, 3, height, width), dtype=torch.uint8), torch.tensor([[0.5, torch.nan]] * 3)
    optimizer = Adam(network.parameters(), 1e-3)
    error = training_step(network, optimizer, pictures, labels, dtype=dtype, micro_batch=2)
    assert not any(node.metadata for node in nodes()), error


@pytest.mark.parametrize("pictures", [2, 0])  # none: no picture of a batch decodes
def test_wide_convolutions_see_what_the_layers_of_the_network_see(pictures: int) -> None:
    torch.manual_seed(4)
    features, inputs = SteeringNetwork().features, torch.randn(pictures, 3, 128, 128)
    assert isinstance(features, FasterLayers)
    torch.testing.assert_close(features.with_wider_convolutions(inputs), features(inputs))


def steps_taken(
    monkeypatch: pytest.MonkeyPatch, *, can_record: bool, error: Exception | None = None
) -> tuple[list[float], Tensor, int]:
    """Squared errors and last weights of seven batches, the third and the last one smaller; and how many times a
    step was recorded. A processor takes the place of the GPU: it calculates what the GPU would replay. A recording
    raises `error`."""
    recorded: list[Tensor] = []

    def recorded_step(calculate: Callable[[], Tensor], device: torch.device) -> tuple[Callable[[], None], Tensor]:
        assert device == machine.device
        result = torch.zeros(())
        recorded.append(result)
        if error is not None:
            raise error

        def replay() -> None:
            result.copy_(calculate())

        return replay, result

    monkeypatch.setattr("model.training.step.record", recorded_step)
    torch.manual_seed(5)
    network = SmallNetwork()
    machine = Machine(torch.device("cuda"), torch.float32, 4)
    steps = TrainingSteps(network, Adam(network.parameters(), 1e-3), machine, 4, None, can_record=can_record)
    height, width, _ = SmallNetwork.PICTURE.shape
    errors = []
    for size in (4, 4, 3, 4, 4, 4, 2):
        pictures = torch.randint(0, 256, (size, 3, height, width), dtype=torch.uint8)
        errors.append(float(steps.take(pictures, torch.rand(size), batch=min(size + 1, 4))))
    return errors, torch.cat([parameter.detach().ravel() for parameter in network.parameters()]), len(recorded)


def test_replayed_steps_learn_what_single_ones_learn(monkeypatch: pytest.MonkeyPatch) -> None:
    errors, weights, recorded = steps_taken(monkeypatch, can_record=True)
    expected, learnt, none = steps_taken(monkeypatch, can_record=False)
    assert (recorded, none) == (1, 0)
    assert errors == expected
    assert torch.equal(weights, learnt)


@pytest.mark.parametrize("error", [torch.OutOfMemoryError("CUDA out of memory.\nTried ..."), TypeError()])
def test_a_step_that_cannot_be_recorded_is_learnt_all_the_same(
    error: Exception, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    errors, weights, tried = steps_taken(monkeypatch, can_record=True, error=error)
    (line,) = caplog.messages
    assert re.fullmatch(r"the GPU records no training step \(\w*Error.*\), so training is slower", line)
    expected, learnt, _ = steps_taken(monkeypatch, can_record=False)
    assert tried == 1
    assert errors == expected
    assert torch.equal(weights, learnt)


@pytest.mark.parametrize("fails", [False, True])
def test_a_step_is_recorded_on_the_gpu_that_trains(fails: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """PyTorch's current GPU may be another one. There, PyTorch would record nothing and raise no error. A failed
    recording leaves another stream current, and random numbers that nothing may draw."""
    current, recording, stream, reset = [torch.device("cuda:1")], [], ["first"], []
    generator = torch.Generator()
    drawn = generator.get_state()

    @contextlib.contextmanager
    def made_current(device: torch.device) -> Iterator[None]:
        current.append(device)
        try:
            yield
        finally:
            current.pop()

    @contextlib.contextmanager
    def graph(graph: object, **settings: object) -> Iterator[None]:
        recording.append(current[-1])
        yield

    def calculate() -> Tensor:
        if fails:
            torch.rand(3, generator=generator)
            stream.append("recording")
            raise RuntimeError("operation not permitted when stream is capturing")
        return torch.ones(())

    kept = SimpleNamespace(replay=lambda: None, reset=lambda: reset.append(True))
    monkeypatch.setattr(torch.cuda, "CUDAGraph", lambda: kept)
    monkeypatch.setattr(torch.cuda, "graph_pool_handle", lambda: (0, 1))
    graphsafe = SimpleNamespace(clone_state=generator.get_state, graphsafe_set_state=generator.set_state)
    monkeypatch.setattr(torch.cuda, "default_generators", (graphsafe,))
    monkeypatch.setattr(torch.cuda, "current_stream", lambda device=None: stream[-1])
    monkeypatch.setattr(torch.cuda, "Stream", lambda: SimpleNamespace(wait_stream=lambda stream: None))
    monkeypatch.setattr(torch.cuda, "stream", lambda stream: contextlib.nullcontext())
    monkeypatch.setattr(torch.cuda, "get_sync_debug_mode", lambda: 0)
    monkeypatch.setattr(torch.cuda, "set_sync_debug_mode", lambda mode: None)
    monkeypatch.setattr(torch.cuda, "set_stream", stream.append)
    monkeypatch.setattr(torch.cuda, "synchronize", lambda: None)
    monkeypatch.setattr(torch._C, "_cuda_endAllocateToPool", lambda device, pool: None, raising=False)
    monkeypatch.setattr(torch.cuda, "device", made_current)
    monkeypatch.setattr(torch.cuda, "graph", graph)
    if fails:
        with pytest.raises(RuntimeError, match="not permitted"):
            record(calculate, torch.device("cuda:0"))
    else:
        assert float(record(calculate, torch.device("cuda:0"))[1]) == 1
    assert (recording, current) == ([torch.device("cuda:0")], [torch.device("cuda:1")])
    assert (stream[-1], reset) == ("first", [True] * fails)
    assert torch.equal(generator.get_state(), drawn)


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
