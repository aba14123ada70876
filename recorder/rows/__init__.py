"""Findings from the numbers of rows: quality, odd stretches, steering habits."""
