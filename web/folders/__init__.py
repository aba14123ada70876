"""The project's folders, on this machine or in stores, and the cache."""
