"""The log: its reader and writer, tags, car, times and gaps."""
