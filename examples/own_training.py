"""A training of one's own in plain PyTorch, on the samples of the index.

python examples/own_training.py index
"""

import sys
from typing import Any

import torch
from torch import Tensor, nn
from torch.utils.data import DataLoader

from dataset import SamplesDataset

EPOCHS, BATCH, RATE, DEGREES = 3, 64, 1e-3, 25.0  # steering 1 is 25 degrees


def network() -> nn.Module:
    layers: list[nn.Module] = []
    for before, planes in ((3, 16), (16, 24), (24, 32), (32, 48)):
        layers += [nn.Conv2d(before, planes, 5, stride=2), nn.ReLU()]
    return nn.Sequential(*layers, nn.Flatten(), nn.LazyLinear(32), nn.ReLU(), nn.Linear(32, 1), nn.Flatten(0))


def inputs(pictures: Tensor) -> Tensor:
    """The layers' input for pictures (N, height, width, 3), uint8."""
    return pictures.permute(0, 3, 1, 2) / 127.5 - 1.0


def rmse_deg(errors: list[Tensor]) -> float:
    return DEGREES * torch.cat(errors).square().mean().sqrt().item()


def main(index: str) -> None:
    with SamplesDataset(index, "train") as samples, SamplesDataset(index, "validation") as held_out:
        learn(samples, held_out)


def learn(samples: Any, held_out: Any) -> None:
    torch.manual_seed(0)
    train = DataLoader(samples, BATCH, shuffle=True)  # num_workers=8: decoded in as many processes
    validation = DataLoader(held_out, BATCH)
    net = network()
    net(inputs(next(iter(train))[0]))  # the lazy layer gets its size
    optimizer = torch.optim.Adam(net.parameters(), lr=RATE)
    print(
        f"{len(samples):,} samples; always zero: RMSE {rmse_deg([label for _, label in validation]):.2f} degrees"
    )
    for epoch in range(1, EPOCHS + 1):
        for pictures, steering in train:
            optimizer.zero_grad()
            nn.functional.mse_loss(net(inputs(pictures)), steering).backward()
            optimizer.step()
        with torch.inference_mode():
            errors = [net(inputs(pictures)) - steering for pictures, steering in validation]
        print(f"epoch {epoch}: RMSE {rmse_deg(errors):.2f} degrees")


if __name__ == "__main__":
    main(sys.argv[1])
