"""The frames of the logs: one row a camera picture, with its flags, its driver and its side of the split."""
