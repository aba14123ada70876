"""Whether a gRPC server answers on a connection, such as Ray's or a Rerun viewer's."""

from __future__ import annotations

import socket
from typing import Final

# a client's first bytes in HTTP/2, and an empty SETTINGS frame (RFC 9113, 3.4 and 6.5): gRPC answers with its own
_PREFACE: Final = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
_FRAME_HEADER_BYTES: Final = 9
_SETTINGS: Final = 4


def speaks_grpc(connection: socket.socket) -> bool:
    """True if the other side begins as every gRPC server does. Raises OSError."""
    connection.sendall(_PREFACE)
    answer = connection.recv(_FRAME_HEADER_BYTES)
    return len(answer) == _FRAME_HEADER_BYTES and answer[3] == _SETTINGS
