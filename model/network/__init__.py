"""The network: its layers, how they are laid out for a processor, and where they look."""
