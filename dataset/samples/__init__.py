"""The balanced samples that training reads: chosen and labelled from the frames, written, and read."""
