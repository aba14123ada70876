"""The index: build it from logs, update it, check it and report on it."""
