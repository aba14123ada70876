"""Where sessions come from: other programs' recordings and logs, the built-in simulator, live telemetry."""
