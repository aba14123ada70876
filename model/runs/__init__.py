"""Run folders: what a training leaves behind, where it came from, and what others can make of it."""
