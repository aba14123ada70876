"""The network of a training or a run: its name, its arguments, how to build it, and how to test it."""

from __future__ import annotations

import contextlib
import importlib
import inspect
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Final

import numpy as np
import torch
from torch import Tensor, nn
from torch.nn.parameter import is_lazy

from common.errors import UsageError, printable
from common.named_function import in_one_line
from dataset.picture_spec import ORIGINAL, PictureSpec
from model.config import TrainConfig
from model.errors import RunError
from model.network.names import BUILT_IN, is_own
from model.network.own_code import OwnCode, load_code
from model.network.picture_network import PictureNetwork

_TRIED: Final = 2  # pictures: one would not reveal a network that mixes up the pictures of a batch


class OwnNetwork(PictureNetwork):
    """A user's own module: it receives pictures as float32 -1..1, (N, 3, height, width)."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def answers(self, inputs: Tensor) -> Tensor:
        answers: Tensor = self.network(inputs)
        return answers


@dataclass(frozen=True)
class NetworkChoice:
    """A network that can be built any number of times."""

    name: str  # of a built-in network, or `OwnCode.label`
    arguments: Mapping[str, Any]
    make: Callable[..., Any] = field(repr=False)
    code: OwnCode | None = None
    outputs: int = 1  # number of targets that the network answers

    @property
    def description(self) -> dict[str, Any]:
        """The value of `network` in a run's config.json."""
        checksum = {} if self.code is None or not self.code.source else {"file_sha256": self.code.file_sha256}
        return {"name": self.name, "arguments": dict(self.arguments), **checksum}

    @property
    def picture(self) -> PictureSpec:
        """The network's default picture. Raises RunError if its `PICTURE` is not a PictureSpec."""
        picture = getattr(self.make, "PICTURE", ORIGINAL)
        if not isinstance(picture, PictureSpec):
            raise RunError(f"{self._label}: its PICTURE is a {type(picture).__name__}, expected a PictureSpec")
        return picture

    def build(self) -> PictureNetwork:
        """A new network with random weights. Raises RunError if that fails."""
        # With one target, `outputs` keeps its default: in an older network it may have another meaning.
        taken = _parameter(self.make, "outputs")
        is_given = taken is not None and (self.outputs > 1 or taken.default is taken.empty)
        outputs = {"outputs": self.outputs} if is_given else {}
        try:
            made = self.make(**{**outputs, **self.arguments})
        except RunError:
            raise
        except Exception as error:
            arguments = ", ".join(f"{name}={value!r}" for name, value in self.arguments.items())
            raise RunError(f"{self._label}({printable(arguments)}) fails ({_why(error)})") from None
        if not isinstance(made, nn.Module):
            raise RunError(f"{self._label} returns a {type(made).__name__}, expected a torch.nn.Module")
        network = made if isinstance(made, PictureNetwork) else OwnNetwork(made)
        network.outputs = self.outputs
        return network

    def try_out(self, picture: PictureSpec, device: torch.device) -> int:
        """Build a network and let it answer pictures. Returns the number of its parameters.

        Raises RunError if the answers are not one finite number for each picture and target, or if a run cannot
        store the weights. PyTorch's meta device would import for a second; a real answer takes a twentieth of it.
        """
        with torch.random.fork_rng(devices=[]):
            network = self.build()
            if self.code is None:
                self.try_network(network, picture)
            else:
                self._refuse_unkeepable(network)
                self.try_network(self._moved(network, device), picture)
        return sum(parameter.numel() for parameter in network.parameters())

    @torch.inference_mode()
    def try_network(self, network: PictureNetwork, picture: PictureSpec) -> None:
        """Let a network answer pictures. Raises RunError if it fails, or its answers are not finite numbers."""
        height, width, _ = picture.shape
        device = next(network.parameters()).device
        noise = np.random.default_rng(0).integers(0, 256, (_TRIED, height, width, 3), np.uint8)
        pictures = torch.from_numpy(noise).permute(0, 3, 1, 2).to(device)
        was_training = network.training
        network.eval()
        try:
            answers = network(pictures)
        except RunError as error:
            raise RunError(f"{self._label}: {error}") from None
        except Exception as error:
            raise RunError(
                f"{self._label} cannot take pictures of {picture.width_px} x {picture.height_px} px"
                f" ({_why(error)}); give a size that it can take with --picture-px WIDTH HEIGHT"
            ) from None
        network.train(was_training)
        if not answers.isfinite().all():
            raise RunError(f"{self._label} gives an answer that is not finite")

    @property
    def _label(self) -> str:
        return f"--network {printable(self.name)}"

    def _moved(self, network: PictureNetwork, device: torch.device) -> PictureNetwork:
        try:
            return network.to(device)
        except (RuntimeError, NotImplementedError) as error:
            raise RunError(f"{self._label} cannot be moved to {device} ({_why(error)})") from None

    def _refuse_unkeepable(self, network: PictureNetwork) -> None:
        if not any(parameter.requires_grad for parameter in network.parameters()):
            raise RunError(f"{self._label} has no parameters: there is nothing to learn")
        owners: dict[int, str] = {}
        for name, tensor in network.state_dict(keep_vars=True).items():
            if is_lazy(tensor):
                raise RunError(
                    f"{self._label}: {name} has no size yet; give the layer its size: lazy layers do not work"
                )
            other = owners.setdefault(tensor.untyped_storage().data_ptr(), name) if tensor.numel() else name
            if other != name:
                raise RunError(f"{self._label}: {other} and {name} share their weights, which a run cannot store")


def choose_network(config: TrainConfig) -> NetworkChoice:
    """The network of a training. Runs the code of a user's own network. Raises RunError if the code is missing."""
    arguments = _parsed(config.network_args)
    if is_own(config.network):
        code = load_code(config.network)
        choice = NetworkChoice(code.label, arguments, code.make, code)
    else:
        standardized = {"standardized": True} if config.light == "standardized" else {}
        choice = built_in(config.network, {**standardized, **arguments})
    choice = replace(choice, outputs=len(config.targets))
    if _parameter(choice.make, "dropout") is not None:
        return replace(choice, arguments={"dropout": config.dropout, **choice.arguments})
    if config.dropout not in (0.0, TrainConfig.dropout):
        raise UsageError(
            f"--dropout {config.dropout:g}: the network {printable(choice.name)} has none; leave it out"
        )
    return choice


def built_in(name: str, arguments: Mapping[str, Any]) -> NetworkChoice:
    module, _, kind = BUILT_IN[name].partition(":")
    return NetworkChoice(name, arguments, getattr(importlib.import_module(module), kind))


def chosen_picture(config: TrainConfig, network: NetworkChoice) -> PictureSpec:
    """The picture that the network of a training sees: the network's default with the given settings. Raises
    UsageError for settings that give no picture."""
    wanted: dict[str, Any] = {}
    if config.picture_px is not None:
        wanted["width_px"], wanted["height_px"] = config.picture_px
    if config.crop_rows is not None:
        wanted["crop_top"], wanted["crop_bottom"] = config.crop_rows
    if config.channels is not None:
        wanted["channels"] = config.channels
    try:
        return replace(network.picture, **wanted)
    except ValueError as error:
        raise UsageError(f"--picture-px and --crop-rows: {error}") from None


def _parsed(arguments: Sequence[str]) -> dict[str, Any]:
    """The values of NAME=VALUE arguments: JSON if the value is valid JSON, else text."""
    values: dict[str, Any] = {}
    for argument in arguments:
        name, _, text = argument.partition("=")
        values[name] = text
        with contextlib.suppress(ValueError, RecursionError):
            values[name] = json.loads(text)
    return values


def _parameter(make: Callable[..., Any], name: str) -> inspect.Parameter | None:
    try:
        return inspect.signature(make).parameters.get(name)
    except (TypeError, ValueError):  # a callable that is not written in Python
        return None


def _why(error: Exception) -> str:
    # PyTorch without CUDA: "not compiled with CUDA enabled"; with CUDA: "Found no NVIDIA driver"
    about = f"{type(error)} {error}".lower()
    needs_gpu = not torch.cuda.is_available() and ("cuda" in about or "nvidia" in about)
    return in_one_line(error) + (": it needs a GPU, and PyTorch finds none" if needs_gpu else "")
