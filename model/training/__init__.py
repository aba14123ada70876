"""Training: the loop, its steps, how it resumes, and curves for TensorBoard."""
