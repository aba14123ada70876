"""Run folders: weights, checkpoints and history of a training, and where it came from."""
