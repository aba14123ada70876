"""The MCAP file: chunks, CRCs, byte ranges of pictures."""
