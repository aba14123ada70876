"""The web server: the check of requests, start and stop, templates, and responses for errors."""
