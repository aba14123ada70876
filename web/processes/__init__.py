"""Work that separate processes do for pages: predictions, maps and checks of pictures, Rerun."""
