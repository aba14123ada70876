"""The log of a drive, which a thread writes, and its summary."""
