"""Weights and checkpoints that carry their own checksum.

The metadata of the safetensors file hold `sha256`: the SHA-256 of the whole file with these 64 characters as
zeros. In one file, weights and checksum are replaced in one step: they match after a crash, and in copies.
"""

from __future__ import annotations

import functools
import hashlib
import json
import logging
import re
from collections.abc import Mapping
from pathlib import Path
from typing import Final

from safetensors import SafetensorError
from safetensors.torch import load, save
from torch import Tensor, nn

from common.errors import printable
from common.untrusted import read_bounded
from model.errors import RunError
from model.runs.run_files import replaced_file

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
