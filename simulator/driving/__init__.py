"""The car on a track: its physics, its drivers, and the record of its course."""
