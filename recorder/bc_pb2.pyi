from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class VehicleState(_message.Message):
    __slots__ = ("steering", "throttle", "brake", "speed_mph", "device", "not_recorded_s")
    class Device(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        UNKNOWN: _ClassVar[VehicleState.Device]
        KEYBOARD: _ClassVar[VehicleState.Device]
        MOUSE: _ClassVar[VehicleState.Device]
        GAMEPAD: _ClassVar[VehicleState.Device]
        TOUCH: _ClassVar[VehicleState.Device]
    UNKNOWN: VehicleState.Device
    KEYBOARD: VehicleState.Device
    MOUSE: VehicleState.Device
    GAMEPAD: VehicleState.Device
    TOUCH: VehicleState.Device
    STEERING_FIELD_NUMBER: _ClassVar[int]
    THROTTLE_FIELD_NUMBER: _ClassVar[int]
    BRAKE_FIELD_NUMBER: _ClassVar[int]
    SPEED_MPH_FIELD_NUMBER: _ClassVar[int]
    DEVICE_FIELD_NUMBER: _ClassVar[int]
    NOT_RECORDED_S_FIELD_NUMBER: _ClassVar[int]
    steering: float
    throttle: float
    brake: float
    speed_mph: float
    device: VehicleState.Device
    not_recorded_s: float
    def __init__(self, steering: _Optional[float] = ..., throttle: _Optional[float] = ..., brake: _Optional[float] = ..., speed_mph: _Optional[float] = ..., device: _Optional[_Union[VehicleState.Device, str]] = ..., not_recorded_s: _Optional[float] = ...) -> None: ...

class PilotCommand(_message.Message):
    __slots__ = ("predicted_steering", "steering", "throttle", "driver", "set_speed_mph", "decode_ms", "network_ms", "total_ms", "parse_ms", "expert_steering", "predicted_speed_mph", "predicted_throttle", "in_flight")
    class Driver(int, metaclass=_enum_type_wrapper.EnumTypeWrapper):
        __slots__ = ()
        UNKNOWN: _ClassVar[PilotCommand.Driver]
        PILOT: _ClassVar[PilotCommand.Driver]
        HUMAN: _ClassVar[PilotCommand.Driver]
        EXPERT: _ClassVar[PilotCommand.Driver]
        BRAKE: _ClassVar[PilotCommand.Driver]
    UNKNOWN: PilotCommand.Driver
    PILOT: PilotCommand.Driver
    HUMAN: PilotCommand.Driver
    EXPERT: PilotCommand.Driver
    BRAKE: PilotCommand.Driver
    PREDICTED_STEERING_FIELD_NUMBER: _ClassVar[int]
    STEERING_FIELD_NUMBER: _ClassVar[int]
    THROTTLE_FIELD_NUMBER: _ClassVar[int]
    DRIVER_FIELD_NUMBER: _ClassVar[int]
    SET_SPEED_MPH_FIELD_NUMBER: _ClassVar[int]
    DECODE_MS_FIELD_NUMBER: _ClassVar[int]
    NETWORK_MS_FIELD_NUMBER: _ClassVar[int]
    TOTAL_MS_FIELD_NUMBER: _ClassVar[int]
    PARSE_MS_FIELD_NUMBER: _ClassVar[int]
    EXPERT_STEERING_FIELD_NUMBER: _ClassVar[int]
    PREDICTED_SPEED_MPH_FIELD_NUMBER: _ClassVar[int]
    PREDICTED_THROTTLE_FIELD_NUMBER: _ClassVar[int]
    IN_FLIGHT_FIELD_NUMBER: _ClassVar[int]
    predicted_steering: float
    steering: float
    throttle: float
    driver: PilotCommand.Driver
    set_speed_mph: float
    decode_ms: float
    network_ms: float
    total_ms: float
    parse_ms: float
    expert_steering: float
    predicted_speed_mph: float
    predicted_throttle: float
    in_flight: int
    def __init__(self, predicted_steering: _Optional[float] = ..., steering: _Optional[float] = ..., throttle: _Optional[float] = ..., driver: _Optional[_Union[PilotCommand.Driver, str]] = ..., set_speed_mph: _Optional[float] = ..., decode_ms: _Optional[float] = ..., network_ms: _Optional[float] = ..., total_ms: _Optional[float] = ..., parse_ms: _Optional[float] = ..., expert_steering: _Optional[float] = ..., predicted_speed_mph: _Optional[float] = ..., predicted_throttle: _Optional[float] = ..., in_flight: _Optional[int] = ...) -> None: ...

class Prediction(_message.Message):
    __slots__ = ("steering", "recorded_steering")
    STEERING_FIELD_NUMBER: _ClassVar[int]
    RECORDED_STEERING_FIELD_NUMBER: _ClassVar[int]
    steering: float
    recorded_steering: float
    def __init__(self, steering: _Optional[float] = ..., recorded_steering: _Optional[float] = ...) -> None: ...
