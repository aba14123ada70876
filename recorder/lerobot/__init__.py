"""LeRobot datasets that are made of logs."""
