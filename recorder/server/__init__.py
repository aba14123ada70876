"""The Socket.IO server for simulators: allowed clients, both protocols, and the fields of telemetry."""
