"""The data of the index that pages show."""
