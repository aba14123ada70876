"""A person at the wheel: a page's controls, the page that holds the wheel, and the frames for pages."""
