"""A small network with dropout, which is quick to train and whose random numbers have to go on as well."""

from __future__ import annotations

from torch import nn

from model.network.pilotnet import SmallNetwork


class DropoutNetwork(SmallNetwork):
    """The toolkit's small network, which has no dropout, with some."""

    def __init__(self, dropout: float = 0.5) -> None:
        super().__init__()
        self.head.insert(1, nn.Dropout(dropout))
