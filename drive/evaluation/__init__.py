"""Evaluation of networks: driving in closed loop, comparisons, and the reports of `bc-eval`."""
