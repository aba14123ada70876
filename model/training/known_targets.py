"""The check that the training samples have labels of all targets: not every session has them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from dataset import Samples
from dataset.prediction_targets import TARGETS, TargetName
from model.errors import RunError


def target_notices(samples: Samples, targets: Sequence[TargetName]) -> list[str]:
    """A notice for each target that is unknown in some sessions: these are learnt for the others alone.

    Raises RunError where no session does.
    """
    columns = [TARGETS[name].label_column for name in targets[1:]]
    if not columns:
        return []
    training = samples.of_split("train", ["session", "split", *columns])
    session = np.asarray(training["session"])
    notices = []
    for name in targets[1:]:
        is_known = np.isfinite(samples.target_labels(training, name))
        known = set(session[is_known].tolist())
        if not known:
            raise RunError(f"{samples.path}: no session has a {name}; leave it out of --targets")
        if missing := sorted(set(session.tolist()) - known):
            others = ", ".join(other for other in targets if other != name)
            notices.append(f"{samples.path}: no {name} in {', '.join(missing)}: {others} only are learnt there")
    return notices
