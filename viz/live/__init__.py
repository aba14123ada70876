"""A log shown while it is being written."""
