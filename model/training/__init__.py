"""Training: the loop and its steps, checkpoints, several processes, and what is told of it while it goes on."""
