"""What a network makes of pictures before it answers."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from torch import Tensor, nn

from model.network.choice import built_in
from model.network.inner_features import answers_and_features
from model.network.picture_network import PictureNetwork


def pictures(network: PictureNetwork) -> Tensor:
    spec = network.PICTURE
    made = np.random.default_rng(0).integers(0, 256, (3, 3, spec.height_px, spec.width_px), dtype=np.uint8)
    return torch.from_numpy(made)


@pytest.mark.parametrize(("name", "width"), [("small", 64), ("pilotnet", 100), ("original", 1164)])
def test_features_are_those_behind_the_first_full_layer(name: str, width: int) -> None:
    network = built_in(name, {}).build().eval()
    inputs = pictures(network)
    answers, features = answers_and_features(network, inputs)
    assert features.shape == (3, width)
    assert not (features[0] == features[1]).all()
    with torch.inference_mode():
        assert torch.equal(answers, network(inputs))
    assert not any(layer._forward_pre_hooks for layer in network.modules())


class _OneLayer(PictureNetwork):
    def __init__(self, layer: nn.Module) -> None:
        super().__init__()
        self.layer = layer

    def answers(self, inputs: Tensor) -> Tensor:
        return self.layer(inputs.mean((2, 3)))  # type: ignore[no-any-return]


def test_a_network_of_one_full_layer_has_what_goes_into_it() -> None:
    network = _OneLayer(nn.Linear(3, 1))
    assert answers_and_features(network, pictures(network))[1].shape == (3, 3)


def test_a_network_without_one_has_its_answers() -> None:
    network = _OneLayer(nn.AvgPool1d(3))
    answers, features = answers_and_features(network, pictures(network))
    assert torch.equal(features, answers[:, None])
