"""Logs as Rerun recordings: pictures, curves, predictions, and the layout that fits them."""
