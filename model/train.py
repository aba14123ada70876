"""`torchrun --nproc-per-node 2 -m model.train --epochs 10`: bc-train in several processes at once.

Only to be run: imported, it would hide the function `model.train`.
"""

if __name__ != "__main__":
    raise ImportError("`from model import train` gives the function; this module is for `torchrun -m model.train`")

import os
import sys

from model.cli import main

code: object = 0
try:
    main()
except SystemExit as ended:
    code = ended.code
for stream in (sys.stdout, sys.stderr):
    stream.flush()
# Not the usual way out: a thread of the process group that came back meanwhile was seen to abort the process.
os._exit(code if isinstance(code, int) else int(code is not None))
