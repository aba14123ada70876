"""The base of the other packages of behavioural_cloning_toolkit: errors, commands, progress, atomic files.

It imports none of the other packages, and all of them may import it.
"""

from common.errors import Skipped, UserError
from common.files import atomic_file

__all__ = ["Skipped", "UserError", "atomic_file"]
