"""Networks, how their layers are made fast on a processor, and where they look."""
