"""The log itself: an MCAP file, its topics, its reader, writer, checks and edits."""
