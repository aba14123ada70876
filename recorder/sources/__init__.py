"""Sources of sessions: other programs' recordings and logs, the built-in simulator, live telemetry."""
