"""Show a log while it is being written."""
