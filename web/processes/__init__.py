"""Work that a process of its own does for a page: predictions, maps of pictures, Rerun."""
