"""The lines that `bc-train` prints while it trains."""

from __future__ import annotations

from typing import TYPE_CHECKING

from common.errors import counted, decimal
from common.output import print_result

if TYPE_CHECKING:
    from model.config import Keep
    from model.runs.training_progress import Epoch, Step


class EpochPrinter:
    """Prints one line an epoch on stdout; before the first one, the errors of constant predictors."""

    def __init__(self, keep: Keep) -> None:
        """`keep` is how the training chooses the epoch that it keeps."""
        self._has_begun = False
        self._chooses = keep != "last"

    def step(self, step: Step) -> None:
        """Print nothing: the progress bar shows steps."""

    def epoch(self, epoch: Epoch) -> None:
        measures, unit = epoch.measures, epoch.measures.unit
        if measures.frames and not self._has_begun:
            print_result(
                f"errors of {counted(measures.frames, 'frame')} held out, in {unit.name}; always the mean: RMSE"
                f" {unit.of(measures.mean.rmse_deg):.2f}, always zero: {unit.of(measures.zero.rmse_deg):.2f}"
            )
        self._has_begun = True
        validation = (
            f" RMSE {decimal(unit.of(measures.network.rmse_deg), 2)}, balanced"
            f" {decimal(unit.of(measures.balanced_rmse_deg), 2)},"
            f" correlation {decimal(measures.network.correlation, 2)},"
            if measures.frames
            else " nothing held out,"
        )
        print_result(
            f"epoch {epoch.epoch:>2}: loss {decimal(epoch.training_loss, 4)},{validation}"
            f" {epoch.samples_per_s:,.0f} samples/s{', kept' if self._chooses and epoch.is_best else ''}"
        )
        for target in epoch.targets:
            if target.frames:
                print_result(f"          {target}")

    def close(self) -> None:
        """Nothing to close."""
