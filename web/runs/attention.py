"""The attention map of a run's network for a picture, as a transparent picture to lie over it."""

from __future__ import annotations

import threading
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from numpy.typing import NDArray

from model.runs.run_files import CONFIG, WEIGHTS
from web.errors import WebError
from web.folders.file_versions import Newest, version_of
from web.runs.run_configs import check_network

if TYPE_CHECKING:  # these load PyTorch, which only requests need
    from dataset.picture_spec import PictureSpec
    from model.network.picture_network import PictureNetwork

_COLOR: Final = (255, 40, 230)  # BGR; no road has this colour
_MAX_ALPHA: Final = 0.8  # where the network looks most
_UNSEEN_ALPHA: Final = 0.45  # of the black over the rows outside the crop
_MAX_WIDTH_PX: Final = 640
_KEPT: Final = 2  # networks in memory
_ONE_AT_A_TIME: Final = threading.Lock()
_networks: Final[Newest[tuple[PictureNetwork, PictureSpec]]] = Newest(_KEPT)


def attention_overlay(run: Path, log: Path, encoded: bytes) -> bytes:
    """A PNG with the shape of the picture: coloured where the network looks, dark outside its crop.

    Raises RunError for a run that cannot be loaded, or a network without an attention map; WebError for a user's
    own network code, and for a picture that does not decode.
    """
    import torch

    from dataset.preprocessing import decode, preprocess
    from model.errors import RunError
    from model.evaluation.predict import as_input
    from model.network.visual_backprop import visual_backprop
    from model.runs.run_folder import load_network, picture_of_run

    try:
        picture = decode(encoded)
    except ValueError as error:
        raise WebError(f"{log}: this picture does not decode ({error})", 422) from None
    with _ONE_AT_A_TIME:
        torch.set_num_threads(1)  # on a busy machine, several threads for one picture take 20 times as long
        check_network(run, log)
        version = version_of(run / WEIGHTS, run / CONFIG)
        network, spec = _networks.get(run, version, lambda: (load_network(run), picture_of_run(run)))
        try:
            _, maps = visual_backprop(network, as_input(preprocess(picture, spec)[None]))
        except RunError as error:
            raise RunError(f"{run}: {error}") from None
    return _drawn(maps[0].numpy(), picture.shape[0], picture.shape[1], spec)


def _drawn(attention: NDArray[np.float32], height: int, width: int, spec: PictureSpec) -> bytes:
    """`attention` (spec.height_px, spec.width_px), 0 to 1, over the rows of a picture that the network sees."""
    scale = min(1.0, _MAX_WIDTH_PX / width)
    size = max(1, round(height * scale)), max(1, round(width * scale))
    alpha = np.full(size, _UNSEEN_ALPHA, np.float32)
    color = np.zeros((*size, 3), np.uint8)
    rows = spec.crop_slice(size[0])
    part = alpha[rows]
    part[:] = _MAX_ALPHA * cv2.resize(attention, (part.shape[1], part.shape[0]), interpolation=cv2.INTER_LINEAR)
    color[rows] = _COLOR
    ok, png = cv2.imencode(".png", np.dstack([color, np.rint(255 * alpha).astype(np.uint8)]))
    assert ok  # noqa: S101 - of any array of that type
    return png.tobytes()
