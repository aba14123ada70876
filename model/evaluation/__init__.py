"""How far a network is off on recorded frames, and where it is off the most."""
