"""The Socket.IO server that simulators connect to: who may connect, both protocols, and a telemetry's fields."""
