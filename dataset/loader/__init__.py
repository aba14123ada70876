"""The loader: reads pictures from the logs, and decodes, crops, augments and batches them."""
