"""Findings from pictures: the car's turning, the steering's lag, wrong steering."""
