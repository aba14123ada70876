"""What can be wrong with an index."""

from __future__ import annotations

from common import UserError


class DatasetError(UserError):
    """An index that is missing, empty, damaged, or older than its logs; a picture that cannot be decoded."""
