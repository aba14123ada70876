"""The built-in simulator: tracks, a vehicle, cameras, an expert driver, and a client for the protocol of Udacity's
simulator. It does not read logs."""

from behavioural_cloning_toolkit import refuse_hidden

refuse_hidden(__name__)


from simulator.gymnasium_ids import register_environments
from simulator.protocol.client import (
    NoHostError,
    SimulatorClient,
    SimulatorTelemetry,
    SteerCommand,
    WaitTimeoutError,
)

__all__ = ["NoHostError", "SimulatorClient", "SimulatorTelemetry", "SteerCommand", "WaitTimeoutError"]

register_environments()
