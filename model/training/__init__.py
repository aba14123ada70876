"""Training: the loop and its steps, resuming, several processes, and curves for TensorBoard."""
