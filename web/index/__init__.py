"""What pages show of the index."""
