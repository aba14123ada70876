"""A person at the wheel: the controls that a page sends, who holds the wheel, and what the pages are shown."""
