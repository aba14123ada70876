"""The log itself: an MCAP file, its topics, its reader and writer, and what looks after it."""
