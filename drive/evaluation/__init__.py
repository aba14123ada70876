"""Driving measured: in closed loop, and learning from one's own mistakes; offline reports."""
