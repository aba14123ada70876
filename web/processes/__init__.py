"""Work that separate processes do for pages: predictions, maps of pictures, Rerun."""
