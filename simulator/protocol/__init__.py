"""A client for the protocol of Udacity's simulator, and a writer for its recordings."""
