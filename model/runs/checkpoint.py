"""Checkpoints: `last/checkpoint.safetensors`, from which a training continues as if it had never stopped.

One file with its own checksum (checksums.py) holds the weights, their mean, Adam's moments and the position, so
all belong to the same step. It needs no random state: order, dropout and alterations depend only on (seed, epoch,
batch).
"""

from __future__ import annotations

import functools
import hashlib
import json
import logging
import math
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import msgspec
import torch
from msgspec import Meta
from safetensors import SafetensorError, safe_open
from safetensors.torch import load, save
from torch import Tensor, nn

from common.errors import printable
from common.untrusted import read_bounded
from model.adam import Adam
from model.errors import RunError
from model.runs.answer_scale import MAX_CURVE, MAX_OFFSET, MAX_SCALE, MIN_SCALE
from model.runs.run_files import CHECKPOINT, LAST, replaced_file, run_argument

FORMAT: Final = "2"
READABLE: Final = ("1", "2")  # format 1 has neither the mean of the last steps' weights nor the answer scale

_WAY_OUT: Final = "copy it again, or train another run, perhaps from its weights: `bc-train continue RUN`"
_ANOTHER: Final = "the checkpoint of another network than its config.json names"
_MOMENTS: Final = ("exp_avg", "exp_avg_sq", "step")  # what Adam keeps of each parameter

Count = Annotated[int, Meta(ge=0, lt=2**53)]
Sum = Annotated[float, Meta(ge=0)]


class Position(
    msgspec.Struct,
    frozen=True,
    forbid_unknown_fields=True,
    rename={
        "reported_squared_error": "told_squared_error",
        "reported_samples": "told_samples",
        "best_error": "best_deg",
    },
):
    """The position of a training, and the sums of its current epoch."""

    epoch: Annotated[int, Meta(ge=1, lt=2**53)] = 1  # the current epoch; earlier ones are finished
    batch: Count = 0  # learnt batches of this epoch
    squared_error: Sum = 0.0  # over the samples of this epoch so far
    samples: Count = 0
    seconds: Sum = 0.0
    reported_squared_error: Sum = 0.0  # the part of squared_error that is in steps.jsonl
    reported_samples: Count = 0
    best_epoch: Count = 0  # 0: none yet
    answer_scale: Annotated[float, Meta(ge=MIN_SCALE, le=MAX_SCALE)] = 1.0  # of the last finished epoch
    answer_offset: Annotated[float, Meta(ge=-MAX_OFFSET, le=MAX_OFFSET)] = 0.0
    answer_curve: Annotated[float, Meta(ge=0, le=MAX_CURVE)] = 0.0
    best_error: Sum = math.inf  # the error of the kept epoch; infinite if nothing is held out


def checkpoint_path(run: Path) -> Path:
    return run / LAST / CHECKPOINT


def save_checkpoint(
    run: Path, network: nn.Module, averaged: nn.Module, optimizer: Adam, position: Position
) -> None:
    """Replace the run's checkpoint in one step: a full disk or a crash leaves the old one.

    `averaged` has the mean of the last steps' weights; it is `network` itself if nothing is averaged.
    """
    tensors = {f"network.{name}": tensor for name, tensor in network.state_dict().items()}
    if averaged is not network:
        tensors |= {f"averaged.{name}": tensor for name, tensor in averaged.state_dict().items()}
    for name, parameter in network.named_parameters():
        moments = optimizer.state.get(parameter, {})  # empty before the first step
        tensors |= {f"{moment}.{name}": tensor for moment, tensor in moments.items()}
    stored = {"format": FORMAT, "position": json.dumps(msgspec.to_builtins(position))}
    save_checksummed(checkpoint_path(run), tensors, stored)


def read_position(run: Path) -> Position:
    """The position in the run's checkpoint. Raises RunError if the checkpoint is missing or cannot be read."""
    path = _required(run)
    try:
        with safe_open(path, framework="pt") as file:
            stored = file.metadata() or {}
    except (OSError, SafetensorError) as error:
        raise RunError(f"{path}: cannot be read ({error}); {_WAY_OUT}") from None
    return position_of(stored, path)


def _required(run: Path) -> Path:
    path = checkpoint_path(run)
    if not path.is_file():
        raise RunError(
            f"{path}: missing; train another run from its weights: `bc-train continue {run_argument(run)}`"
        )
    return path


def position_of(stored: Mapping[str, str], path: Path) -> Position:
    """The position in the metadata `stored` of the checkpoint `path`. Raises RunError if it cannot be read."""
    try:
        if stored.get("format") not in READABLE:
            raise RunError(
                f"{path}: of format {stored.get('format')}, this toolkit reads {' and '.join(READABLE)};"
                " update the toolkit"
            )
        return msgspec.convert(json.loads(stored["position"]), Position)
    except (KeyError, ValueError, RecursionError) as error:
        raise RunError(f"{path}: cannot be read ({error}); {_WAY_OUT}") from None


def load_checkpoint(run: Path, network: nn.Module, averaged: nn.Module, optimizer: Adam) -> Position:
    """Load the run's checkpoint into the network, the averaged network and the optimizer, on their device. Returns
    the position. `averaged` is `network` itself if nothing is averaged.

    Raises RunError if the checkpoint is damaged, of another version, or of another network.
    """
    path = _required(run)
    tensors, stored = load_checksummed(path, run, network, _WAY_OUT)
    position = position_of(stored, path)
    networks = {"network": network} if averaged is network else {"network": network, "averaged": averaged}
    stepped = {
        name: parameter for name, parameter in network.named_parameters() if f"{_MOMENTS[0]}.{name}" in tensors
    }
    expected = {f"{kind}.{name}" for kind in networks for name in network.state_dict()}
    expected |= {f"{kind}.{name}" for kind in _MOMENTS for name in stepped}
    if tensors.keys() != expected:
        raise RunError(f"{path}: {_ANOTHER}")
    with torch.no_grad():
        for kind, module in networks.items():
            for name, tensor in module.state_dict().items():
                tensor.copy_(_like(tensors[f"{kind}.{name}"], tensor, path))
        for name, parameter in stepped.items():
            optimizer.state[parameter] = _moments(name, parameter, tensors, optimizer, path)
    return position


def _moments(
    name: str, parameter: Tensor, tensors: dict[str, Tensor], optimizer: Adam, path: Path
) -> dict[str, Any]:
    step = tensors[f"step.{name}"]
    if step.shape != () or step.dtype != torch.float32 or not 1 <= step.item() < 2**53:
        raise RunError(f"{path}: its step count is not valid; {_WAY_OUT}")
    return {
        "step": step.to(parameter.device) if optimizer.is_fused else step,
        # in the parameter's memory format, as before saving
        **{
            moment: torch.zeros_like(parameter).copy_(_like(tensors[f"{moment}.{name}"], parameter, path))
            for moment in _MOMENTS[:2]
        },
    }


def _like(tensor: Tensor, parameter: Tensor, path: Path) -> Tensor:
    if tensor.shape != parameter.shape or tensor.dtype != parameter.dtype:
        raise RunError(f"{path}: {_ANOTHER}")
    if not torch.isfinite(tensor).all():
        raise RunError(f"{path}: holds numbers that are not finite; train again with a smaller --rate")
    return tensor


CHECKSUM: Final = "sha256"

_ZEROS: Final = "0" * 64
_MAX_OTHER_BYTES: Final = 1 << 28  # beyond four copies of a network's weights: a checkpoint has four


def save_checksummed(path: Path, tensors: Mapping[str, Tensor], metadata: Mapping[str, str]) -> None:
    """Replace `path` in one step: a full disk or a crash leaves the old file. Equal content gives equal bytes."""
    contiguous = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    header, values = _halves(save(contiguous))
    about = {"__metadata__": dict(sorted({**metadata, CHECKSUM: _ZEROS}.items())), **json.loads(header)}
    text = json.dumps(about, separators=(",", ":")).encode()
    header = text.ljust(-(-len(text) // 8) * 8)  # padded, so that the tensors can be mapped into memory
    header = header.replace(_ZEROS.encode(), _digest(header, values).encode(), 1)
    with replaced_file(path) as part, part.open("wb") as stream:
        stream.write(_length(header))
        stream.write(header)
        stream.write(values)


def load_checksummed(
    path: Path, run: Path, network: nn.Module, otherwise: str
) -> tuple[dict[str, Tensor], dict[str, str]]:
    """The tensors and the metadata of a file of `run`, whose network is `network`, after its checksum is verified.

    A file of an earlier version has no checksum: it is read, with one warning per run. Raises RunError for a
    damaged file, or one too large for the network; its message ends with `otherwise`, the remedy.
    """
    weights_bytes = sum(tensor.nbytes for tensor in network.state_dict().values())
    try:
        data = read_bounded(path, 4 * weights_bytes + _MAX_OTHER_BYTES)
        tensors = load(data)
        header, values = _halves(data)
        metadata = json.loads(header).get("__metadata__") or {}  # null in a file of another program
    except (OSError, SafetensorError, ValueError, RecursionError) as error:
        raise RunError(f"{path}: cannot be read ({error}); {otherwise}") from None
    checksum = metadata.pop(CHECKSUM, None)
    if checksum is None:
        _warn_without_checksum(run)
    elif not _holds(checksum, header, values):
        raise RunError(f"{path}: damaged: its SHA-256 does not match; {otherwise}")
    return tensors, metadata


def _holds(checksum: str, header: bytes, values: memoryview) -> bool:
    if not re.fullmatch("[0-9a-f]{64}", checksum):
        return False
    return _digest(header.replace(checksum.encode(), _ZEROS.encode(), 1), values) == checksum


def _digest(header: bytes, values: memoryview) -> str:
    digest = hashlib.sha256(_length(header) + header)
    digest.update(values)
    return digest.hexdigest()


def _length(header: bytes) -> bytes:
    return len(header).to_bytes(8, "little")


def _halves(data: bytes) -> tuple[bytes, memoryview]:
    """The JSON header and the tensors' values of a whole safetensors file."""
    end = 8 + int.from_bytes(data[:8], "little")
    return data[8:end], memoryview(data)[end:]


@functools.cache
def _warn_without_checksum(run: Path) -> None:
    # by `logging`, so that programs without a command line hear it, too
    logging.getLogger(__name__).warning(
        "%s",
        printable(f"{run}: of an earlier version, without checksums: damage to its weights cannot be detected"),
    )
