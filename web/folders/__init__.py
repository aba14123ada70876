"""The project's folders, and the cache."""
