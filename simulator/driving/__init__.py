"""The car on a track: its physics, its pose, the expert that drives it, and the record of its course."""
