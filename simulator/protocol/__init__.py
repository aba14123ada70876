"""The real simulator's protocol as its client, and the folder of its recordings."""
