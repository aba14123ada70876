"""Exports logs as LeRobot datasets."""
