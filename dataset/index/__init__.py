"""The index: frames of every log, their labels, flags and split, and the balanced samples that training reads."""
