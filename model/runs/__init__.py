"""Run folders: the weights, checkpoints, history and provenance of a training."""
