"""What pages show of sessions and drives."""
