"""The data of runs that pages show."""
