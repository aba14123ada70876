"""The network of a training or a run: its name, its arguments, and how it is made and tried."""

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

_TRIED: Final = 2  # pictures: shows a network that mixes them up


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
    """A network that can be made, again and again."""

    name: str  # of the toolkit's, or as `OwnCode.label`
    arguments: Mapping[str, Any]
    make: Callable[..., Any] = field(repr=False)
    code: OwnCode | None = None
    outputs: int = 1  # how many targets it is to answer

    @property
    def description(self) -> dict[str, Any]:
        """The `network` of a run's config.json."""
        of_file = {} if self.code is None or not self.code.source else {"file_sha256": self.code.file_sha256}
        return {"name": self.name, "arguments": dict(self.arguments), **of_file}

    @property
    def picture(self) -> PictureSpec:
        """The network's default picture. Raises RunError if its `PICTURE` is not a PictureSpec."""
        picture = getattr(self.make, "PICTURE", ORIGINAL)
        if not isinstance(picture, PictureSpec):
            raise RunError(f"{self._label}: its PICTURE is a {type(picture).__name__}: a PictureSpec was expected")
        return picture

    def build(self) -> PictureNetwork:
        """A new network, with random weights. Raises RunError where that fails."""
        # with one target, its default is left: in an older network `outputs` need not mean the targets
        takes_outputs = _takes(self.make, "outputs") and (self.outputs > 1 or _needs(self.make, "outputs"))
        outputs = {"outputs": self.outputs} if takes_outputs else {}
        try:
            made = self.make(**{**outputs, **self.arguments})
        except RunError:
            raise
        except Exception as error:
            given = ", ".join(f"{name}={value!r}" for name, value in self.arguments.items())
            raise RunError(f"{self._label}({printable(given)}) fails ({_why(error)})") from None
        if not isinstance(made, nn.Module):
            raise RunError(f"{self._label} gives a {type(made).__name__}: a torch.nn.Module was expected")
        network = made if isinstance(made, PictureNetwork) else OwnNetwork(made)
        network.outputs = self.outputs
        return network

    def try_out(self, picture: PictureSpec, device: torch.device) -> int:
        """Make a network and show it pictures; returns the number of its parameters.

        Raises RunError for a network that cannot be trained: its answers have another shape than one number a
        picture and target, or are not finite, or its weights cannot be stored. PyTorch's meta device is not used:
        its first answer takes a second of imports, a real answer of the original network a twentieth of that.
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
        """Show a network pictures. Raises RunError if its answers are not steering."""
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
                f" ({_why(error)}); give --picture-px WIDTH HEIGHT that it can"
            ) from None
        network.train(was_training)
        if not answers.isfinite().all():
            raise RunError(f"{self._label} gives an answer that is not a number")

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
    """The network of a training; a user's own code is run. Raises RunError if the code is missing or takes other
    arguments."""
    given = _parsed(config.network_args)
    if is_own(config.network):
        code = load_code(config.network)
        choice = NetworkChoice(code.label, given, code.make, code)
    else:
        choice = built_in(config.network, given)
    choice = replace(choice, outputs=len(config.targets))
    if _takes(choice.make, "dropout"):
        return replace(choice, arguments={"dropout": config.dropout, **given})
    if config.dropout not in (0.0, TrainConfig.dropout):
        raise UsageError(
            f"--dropout {config.dropout:g}: the network {printable(choice.name)} has none; leave it out"
        )
    return choice


def built_in(name: str, arguments: Mapping[str, Any]) -> NetworkChoice:
    """One of the toolkit's own networks."""
    module, _, kind = BUILT_IN[name].partition(":")
    return NetworkChoice(name, arguments, getattr(importlib.import_module(module), kind))


def chosen_picture(config: TrainConfig, network: NetworkChoice) -> PictureSpec:
    """The picture that the network of a training sees: its default, changed by the settings. Raises UsageError for
    settings that give no picture."""
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
    """The values of NAME=VALUE: numbers, true, false and null as in JSON, all else as text."""
    values: dict[str, Any] = {}
    for argument in arguments:
        name, _, text = argument.partition("=")
        values[name] = text
        with contextlib.suppress(ValueError, RecursionError):
            values[name] = json.loads(text)
    return values


def _takes(make: Callable[..., Any], argument: str) -> bool:
    try:
        return argument in inspect.signature(make).parameters
    except (TypeError, ValueError):  # of what is not written in Python
        return False


def _needs(make: Callable[..., Any], argument: str) -> bool:
    """Whether an argument, which it takes, has no default."""
    return inspect.signature(make).parameters[argument].default is inspect.Parameter.empty


def _why(error: Exception) -> str:
    needs_gpu = not torch.cuda.is_available() and "cuda" in f"{type(error)} {error}".lower()
    return in_one_line(error) + (": it needs a GPU, and PyTorch finds none here" if needs_gpu else "")
