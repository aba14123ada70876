"""From a telemetry to a command: picture, the network's steering, speed, brake, takeover."""
