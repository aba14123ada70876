"""The built-in simulator: tracks, a vehicle, cameras, an expert driver, and a client for the protocol of Udacity's
simulator. It does not read logs."""

from typing import TYPE_CHECKING

from common.lazy import lazy_names
from simulator.gymnasium_ids import register_environments

if TYPE_CHECKING:
    from simulator.protocol.client import (
        NoHostError,
        SimulatorClient,
        SimulatorTelemetry,
        SteerCommand,
        WaitTimeoutError,
    )

__all__ = ["NoHostError", "SimulatorClient", "SimulatorTelemetry", "SteerCommand", "WaitTimeoutError"]

__getattr__, __dir__ = lazy_names(__name__, dict.fromkeys(__all__, "simulator.protocol.client"))

register_environments()
