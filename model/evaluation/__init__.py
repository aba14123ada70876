"""Predictions of trained networks for recorded frames, and their errors."""
