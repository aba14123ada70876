"""Logs as Rerun recordings: pictures, curves, predictions and their layout."""
