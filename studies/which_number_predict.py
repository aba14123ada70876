"""Write a network's predictions for every frame of some logs: a step of which_number.py.

python studies/which_number_predict.py RUN TO.parquet LOG...
"""

from __future__ import annotations

import argparse
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as pq

from common.files import atomic_file
from model.evaluation.evaluate import evaluate_sessions


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("run")
    parser.add_argument("to", type=Path)
    parser.add_argument("logs", nargs="+")
    chosen = parser.parse_args()
    # one log at a time: drives that begin at the same place have the same first picture, which counts only once
    frames = pa.concat_tables([evaluate_sessions(chosen.run, [log]).frames for log in chosen.logs])
    with atomic_file(chosen.to, overwrite=True) as part:
        pq.write_table(frames, part)


if __name__ == "__main__":
    main()
