"""Roads by name: built-in roads, as lists of stretches, and random roads from a seed."""
