"""Training: the loop and its steps, resuming, and curves for TensorBoard."""
