"""From a telemetry message to a command: picture, the network's steering, speed, brake, takeover."""
