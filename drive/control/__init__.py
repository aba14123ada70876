"""From a telemetry to a command: the picture, the network's steering, the speed, the brake, who drives."""
