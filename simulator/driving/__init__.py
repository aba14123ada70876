"""The car on a track: its physics, its drivers, and the measures of its drive."""
