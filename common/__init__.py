"""The floor under the rooms of behavioural_cloning_toolkit: errors, commands, progress, whole files.

It imports no other room, and every room may import it.
"""

from common.errors import Skipped, UserError
from common.files import atomic_file

__all__ = ["Skipped", "UserError", "atomic_file"]
