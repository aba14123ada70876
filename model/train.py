"""`torchrun --nproc-per-node 2 -m model.train --epochs 10`: bc-train in several processes at once, where it is not
installed as a command.

Only to be run: imported, it would hide the function `model.train`.
"""

if __name__ != "__main__":
    raise ImportError("`from model import train` gives the function; this module is for `torchrun -m model.train`")

from behavioural_cloning_toolkit import bc_train

bc_train()
