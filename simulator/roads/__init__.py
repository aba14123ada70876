"""Roads by name, as lists of stretches, and made from a seed."""
