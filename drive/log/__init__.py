"""The log of a drive, written beside it, and its summary."""
