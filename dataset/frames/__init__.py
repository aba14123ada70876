"""The frames of the logs: one row for each camera picture, with its flags, driver and split."""
