"""The car on a track: its physics, its pose, whoever drives it, and the record of its course."""
