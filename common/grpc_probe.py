"""Check whether a gRPC server, such as Ray or a Rerun viewer, answers on a connection."""

from __future__ import annotations

import socket
from typing import Final

# The first bytes of an HTTP/2 client, and an empty SETTINGS frame (RFC 9113, sections 3.4 and 6.5). A gRPC server
# answers with a SETTINGS frame.
_PREFACE: Final = b"PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n" + bytes([0, 0, 0, 4, 0, 0, 0, 0, 0])
_FRAME_HEADER_BYTES: Final = 9
_SETTINGS: Final = 4


def speaks_grpc(connection: socket.socket) -> bool:
    """True if the answer begins with a SETTINGS frame, as that of every gRPC server. Raises OSError."""
    connection.sendall(_PREFACE)
    answer = connection.recv(_FRAME_HEADER_BYTES)
    return len(answer) == _FRAME_HEADER_BYTES and answer[3] == _SETTINGS
