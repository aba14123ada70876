"""The folders behind the pages, in stores too: what is in them, and what is kept of it."""
