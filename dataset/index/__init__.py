"""The index: built from logs, kept up to date, checked and reported on."""
