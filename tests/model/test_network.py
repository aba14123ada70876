"""The network is the one of the design, layer by layer."""

from __future__ import annotations

from itertools import pairwise

from torch import nn

from model.network.pilotnet import SteeringNetwork


def test_every_layer_has_the_parameters_of_the_design() -> None:
    counts = [
        sum(parameter.numel() for parameter in layer.parameters())
        for layer in SteeringNetwork().modules()
        if isinstance(layer, nn.Conv2d | nn.Linear)
    ]
    convolutions = [(5, 3, 24), (5, 24, 36), (5, 36, 48), (3, 48, 64), (3, 64, 64)]
    dense = list(pairwise([4096, 1164, 100, 50, 10, 1]))
    assert counts == [
        *(size * size * inputs * outputs + outputs for size, inputs, outputs in convolutions),
        *(inputs * outputs + outputs for inputs, outputs in dense),
    ]
    assert sum(counts) == 5_022_327


def test_dropout_stands_before_each_of_the_two_widest_layers() -> None:
    head = list(SteeringNetwork(dropout=0.3).head)
    before = [following for layer, following in pairwise(head) if isinstance(layer, nn.Dropout)]
    assert [layer.out_features for layer in before if isinstance(layer, nn.Linear)] == [1164, 100]
    assert {layer.p for layer in head if isinstance(layer, nn.Dropout)} == {0.3}


def test_a_new_network_begins_as_keras_would() -> None:
    """PyTorch's own initial weights are smaller: its network answers alike to every picture for an epoch."""
    for layer in SteeringNetwork().modules():
        if isinstance(layer, nn.Conv2d | nn.Linear):
            receptive = layer.weight[0, 0].numel()
            limit = (6 / (receptive * (layer.weight.shape[0] + layer.weight.shape[1]))) ** 0.5
            # uniform within the limit of Glorot and Bengio 2010, formula 16
            assert layer.weight.abs().max().item() <= limit
            tolerance = 0.5 if layer.weight.numel() < 100 else 0.1
            assert abs(layer.weight.std().item() / (limit / 3**0.5) - 1) < tolerance
            assert layer.bias is not None
            assert not layer.bias.any()
