from google.protobuf.internal import enum_type_wrapper as _enum_type_wrapper
from google.protobuf import descriptor as _descriptor
from google.protobuf import message as _message
from typing import ClassVar as _ClassVar, Optional as _Optional, Union as _Union

DESCRIPTOR: _descriptor.FileDescriptor

class VehicleState(_message.Message):
    __slots__ = ("steering", "throttle", "brake", "speed_mph")
    STEERING_FIELD_NUMBER: _ClassVar[int]
    THROTTLE_FIELD_NUMBER: _ClassVar[int]
    BRAKE_FIELD_NUMBER: _ClassVar[int]
    SPEED_MPH_FIELD_NUMBER: _ClassVar[int]
    steering: float
    throttle: float
    brake: float
    speed_mph: float
    def __init__(self, steering: _Optional[float] = ..., throttle: _Optional[float] = ..., brake: _Optional[float] = ..., speed_mph: _Optional[float] = ...) -> None: ...

class PilotCommand(_message.Message):
    __slots__ = ("predicted_steering", "steering", "throttle", "driver", "set_speed_mph", "decode_ms", "network_ms", "total_ms", "parse_ms", "expert_steering", "predicted_speed_mph", "predicted_throttle")
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
    def __init__(self, predicted_steering: _Optional[float] = ..., steering: _Optional[float] = ..., throttle: _Optional[float] = ..., driver: _Optional[_Union[PilotCommand.Driver, str]] = ..., set_speed_mph: _Optional[float] = ..., decode_ms: _Optional[float] = ..., network_ms: _Optional[float] = ..., total_ms: _Optional[float] = ..., parse_ms: _Optional[float] = ..., expert_steering: _Optional[float] = ..., predicted_speed_mph: _Optional[float] = ..., predicted_throttle: _Optional[float] = ...) -> None: ...

class Prediction(_message.Message):
    __slots__ = ("steering", "recorded_steering")
    STEERING_FIELD_NUMBER: _ClassVar[int]
    RECORDED_STEERING_FIELD_NUMBER: _ClassVar[int]
    steering: float
    recorded_steering: float
    def __init__(self, steering: _Optional[float] = ..., recorded_steering: _Optional[float] = ...) -> None: ...
