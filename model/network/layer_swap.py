"""Layers of a network put in the place of others, wherever in it they are."""

from __future__ import annotations

from collections.abc import Callable

from torch import nn

Swap = Callable[[nn.Module], nn.Module | None]
"""Returns the layer to put in the place of another; None to leave it."""


def swap_layers(network: nn.Module, swap: Swap) -> Callable[[], None]:
    """Put new layers in the place of a network's own; returns what undoes it.

    If `swap` raises, nothing is changed.
    """
    found = [
        (parent, name, layer, new)
        for parent in network.modules()
        for name, layer in parent.named_children()
        if (new := swap(layer)) is not None
    ]
    for parent, name, _, new in found:
        setattr(parent, name, new)

    def undo() -> None:
        for parent, name, layer, _ in found:
            setattr(parent, name, layer)

    return undo
