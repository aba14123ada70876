"""The loader: pictures read out of the logs, decoded, cropped, augmented, in batches."""
