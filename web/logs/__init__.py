"""The data of sessions and drives that pages show."""
