"""Starting from another run's weights: only where it is the same network, of the same pictures and targets."""

from __future__ import annotations

from pathlib import Path

from common.errors import printable
from dataset.picture_spec import PictureSpec
from dataset.prediction_targets import TargetName
from model.errors import RunError
from model.network.choice import NetworkChoice
from model.network.names import is_own
from model.runs.network_of_run import network_flag, picture_of, stored_network, stored_targets
from model.runs.run_folder import config_folder, load_config


def refuse_other_network(
    init: Path, network: NetworkChoice, picture: PictureSpec, targets: tuple[TargetName, ...]
) -> None:
    """Raise RunError if a training of `network` cannot start from the weights of the run `init`."""
    config, folder = load_config(init), config_folder(init)
    before = stored_network(config, folder)
    if before.name != network.name and not (is_own(before.name) and is_own(network.name)):
        raise RunError(
            f"{init}: its network is {printable(before.name)}, and {printable(network.name)} cannot start from its"
            f" weights; give {network_flag(before, folder)}, or another --init"
        )
    answered = stored_targets(config, folder)
    if answered != targets:
        raise RunError(
            f"{init}: its network answers {' '.join(answered)}, and this one {' '.join(targets)}; give --targets"
            f" {' '.join(answered)}"
        )
    own = picture_of(config, folder)
    if own != picture:
        raise RunError(
            f"{init}: its network sees {own}, and this one {picture}; give --picture-px {own.width_px}"
            f" {own.height_px} --crop-rows {own.crop_top} {own.crop_bottom} --channels {own.channels}"
        )
