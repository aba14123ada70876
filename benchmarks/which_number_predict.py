"""Writes what a network predicts of every frame of some logs: a step of which_number.py.

python benchmarks/which_number_predict.py RUN TO.parquet LOG...
"""

from __future__ import annotations

import sys
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from common.files import atomic_file
from model.evaluation.evaluate import evaluate_sessions


def main() -> None:
    run, to, *logs = sys.argv[1:]
    # one by one: two drives that begin at rest at the same place have the same first picture
    frames = pa.concat_tables([evaluate_sessions(run, [log]).frames for log in logs])
    with atomic_file(Path(to), overwrite=True) as part:
        pq.write_table(frames, part)


if __name__ == "__main__":
    main()
