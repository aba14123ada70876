"""The file: chunks, CRCs, byte ranges of pictures, what damage left."""
