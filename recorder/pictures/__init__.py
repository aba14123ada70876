"""Camera pictures as bytes: how large they are, whether they are whole, whether they decode and change."""
