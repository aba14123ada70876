"""Commands that pages start: their forms, and those that run."""
