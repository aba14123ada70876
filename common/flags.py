"""What a command's flags are called in `--help`, for settings that are also used where no command line is.

Training runs where tyro is not installed: there, these annotations say nothing.
"""

from __future__ import annotations

try:
    from tyro.conf import arg
except ImportError:

    def arg(**said: object) -> None:  # type: ignore[no-redef]
        """Stands in an `Annotated` type."""


__all__ = ["arg"]
