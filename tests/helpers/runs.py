"""Runs with a history, as pages show them."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tests.helpers.driving import untrained_run
from tests.helpers.histories import epoch_line, step_lines, write_lines


def a_run(runs: Path, name: str, rmse_deg: float = 2.0, **training: Any) -> Path:
    """A run of two epochs, of which the first one was kept."""
    run = untrained_run(runs / name)
    config = json.loads((run / "config.json").read_text())
    config["training"] = {"epochs": 3, "recipe": "people", **training}
    config["data"] = {"logs": {"sunday": {}, "monday": {}}, "settings": {"bins": 25}}
    (run / "config.json").write_text(json.dumps(config))
    lines = [epoch_line(1), epoch_line(2, is_best=False)]
    lines[0]["validation"]["rmse_deg"] = rmse_deg
    lines[0]["mean"]["rmse_deg"] = 4.0
    (run / "metrics.jsonl").unlink(missing_ok=True)
    write_lines(run / "metrics.jsonl", lines)
    write_lines(run / "steps.jsonl", step_lines(1))
    return run
