"""Networks, faster layers for processors, and attention maps."""
