"""The real simulator's side of the connection, and its recordings' folder."""
