"""Camera pictures as bytes: sizes, completeness, decoding, repetitions."""
