"""The listening port and its guard: other programs, such as browsers and scanners, get a clear answer and time
limits, and web pages of other sites may not reach the server.

Each notice is one line with the next step.
"""

from __future__ import annotations

import contextlib
import errno
import ipaddress
import math
import re
import selectors
import socket
import time
from collections.abc import Callable, Iterable
from http import HTTPMethod
from typing import Any, Final
from urllib.parse import parse_qs

from common.location import shown_address
from recorder.errors import ListenError

Notify = Callable[[str], None]

REQUEST_S: Final = 10.0  # the time limit for a whole request, and for the first byte of a new connection
MAX_CONNECTIONS: Final = 128
END_S: Final = 0.5  # the time connections have to end by themselves, their last commands sent, before they are cut

LANDING_PAGE: Final = (
    "This port is for driving simulators: start one in autonomous mode, and it connects by itself.\n"
)

NOTICE_BROWSER: Final = "a browser has opened this port: start the simulator's autonomous mode instead"
NOTICE_NOT_HTTP: Final = (
    "a client sent no whole HTTP request: if it is another program, give one of the two another port"
)
NOTICE_SLOW: Final = (
    f"disconnected a client without a whole request in {REQUEST_S:g} s: a simulator sends at once, start one"
)
NOTICE_TOO_MANY: Final = f"{MAX_CONNECTIONS} connections at once: close some, further ones are not served"

_METHODS: Final = tuple(f"{method} ".encode() for method in HTTPMethod)


class OpenConnections:
    """The open connections, and the deadlines of those without a complete request."""

    def __init__(self, notify: Notify) -> None:
        self._notify = notify
        self._deadlines_s: dict[Any, float] = {}  # time.monotonic(); infinite before a request and after it

    def add(self, stream: Any, limit_s: float = math.inf) -> None:
        """Add a connection, or change its time limit: `REQUEST_S` for a request, none before it and after it."""
        self._deadlines_s[stream] = time.monotonic() + limit_s

    def remove(self, stream: Any) -> None:
        self._deadlines_s.pop(stream, None)

    def close_overdue(self) -> None:
        """Cut the connections whose request is late. Call it regularly.

        A socket's timeout counts from byte to byte: a client that sends a byte now and then never reaches it.
        """
        now_s = time.monotonic()
        for stream, deadline_s in list(self._deadlines_s.items()):
            if now_s > deadline_s:
                self._notify(NOTICE_SLOW)
                _shut_down(stream)

    def close_all(self) -> None:
        for stream in list(self._deadlines_s):
            _shut_down(stream)


def landing_page(notify: Notify) -> Callable[[dict[str, Any], Callable[..., Any]], Iterable[bytes]]:
    """A web application that explains the port to a browser."""

    def show(environ: dict[str, Any], start_response: Callable[..., Any]) -> Iterable[bytes]:
        notify(NOTICE_BROWSER)
        text = LANDING_PAGE.encode()
        headers = [("Content-Type", "text/plain; charset=utf-8"), ("Content-Length", str(len(text)))]
        start_response("200 OK" if environ.get("PATH_INFO") in ("", "/") else "404 Not Found", headers)
        return [text]

    return show


def _shut_down(stream: Any) -> None:
    with contextlib.suppress(OSError):
        stream.shutdown(socket.SHUT_RDWR)


def first_bytes_problem(connection: socket.socket) -> str | None:
    """The notice about a connection that does not begin with an HTTP request. None if it does; empty if the client
    has left."""
    connection.settimeout(REQUEST_S)
    try:
        first = connection.recv(8, socket.MSG_PEEK)
    except TimeoutError:
        return NOTICE_SLOW
    except (OSError, EOFError):  # the latter is eventlet's
        return ""
    if not first:
        return ""
    if any(method.startswith(first) or first.startswith(method) for method in _METHODS):
        return None
    return NOTICE_NOT_HTTP


_LOOPBACK_NAMES: Final = ("localhost", "localhost.localdomain", "ip6-localhost")
_PLACE: Final = re.compile(
    r"(?:[A-Za-z][A-Za-z0-9+.-]*:)?//(?:\[(?P<address>[^\s\[\]@/]+)\]|(?P<name>[^\s\[\]@/\\?#:]+))(?::[0-9]{0,5})?/?"
)
_PRIVATE: Final = (".local", ".internal", ".home.arpa")


class AllowedHosts:
    """The check of a request's `Host` and `Origin`: loopback names and addresses, and the server's `--host`.

    Any page in the user's browser can reach every port of this machine. Its requests have the page's address as
    `Origin`, and as `Host` the name that the browser connected to. After DNS rebinding, this is the attacker's
    name, and it leads to this machine. Numeric addresses and private names cannot be rebound.

    A server that listens everywhere (0.0.0.0) also allows every address, and names of private networks.
    """

    def __init__(self, host: str) -> None:
        self._host = _normalised(host.strip("[]"))
        self._is_everywhere = not host or (
            _is_address(self._host) and ipaddress.ip_address(self._host).is_unspecified
        )

    def why_refused(self, environ: dict[str, Any]) -> str:
        """The part of a WSGI request that is not allowed; empty if all of it is. Programs other than browsers may
        leave out both headers."""
        host, origin = environ.get("HTTP_HOST"), environ.get("HTTP_ORIGIN")
        if host is not None and not self._allows_host(_name(f"//{host}")):
            return f"by the name {host}"
        if origin is not None and not self.allows(origin, environ):
            return f"from {origin}"
        # the answer is a script, which pages of all sites may run
        return "by JSONP" if "j" in parse_qs(environ.get("QUERY_STRING", "")) else ""

    def allows(self, origin: str | None, environ: dict[str, Any]) -> bool:
        """True if a page of that origin may connect."""
        name = _name(origin or "")
        if not name:
            return False
        return is_loopback(name) or name in (self._host, _name(f"//{environ.get('HTTP_HOST', '')}"))

    def _allows_host(self, name: str) -> bool:
        if not name or is_loopback(name) or name == self._host:
            return bool(name)
        is_private = "." not in name or name.endswith(_PRIVATE) or name == _normalised(socket.gethostname())
        return self._is_everywhere and (is_private or _is_address(name))


def _name(url: str) -> str:
    """The host in `//HOST` or `SCHEME://HOST`; empty for anything else, also where a user is named before the host
    (`evil.example@127.0.0.1`) or something follows an address (`[::1].evil.example`)."""
    matched = _PLACE.fullmatch(url)
    return _normalised(matched["address"] or matched["name"]) if matched else ""


def _normalised(name: str) -> str:
    return name.lower().rstrip(".")


def is_loopback(name: str) -> bool:
    """True for this machine's own names and addresses, which no other can reach."""
    if name in _LOOPBACK_NAMES or name.endswith(".localhost"):
        return True
    return _is_address(name) and ipaddress.ip_address(name).is_loopback


def _is_address(name: str) -> bool:
    try:
        ipaddress.ip_address(name)
    except ValueError:
        return False
    return True


def send_at_once(connection: socket.socket) -> None:
    connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def has_unread(stream: socket.socket) -> bool:
    """True if there is unread data, or the other side has hung up."""
    try:
        with selectors.DefaultSelector() as selector:
            selector.register(stream, selectors.EVENT_READ)
            return bool(selector.select(0))
    except (OSError, ValueError):  # closed
        return False


def listen(host: str, port: int, kind: type[Any] = socket.socket) -> Any:
    """A socket of class `kind` that listens on host:port; port 0 takes a free one. Raises ListenError if that
    fails.

    `eventlet.listen` shares ports: a second server would silently take half of the connections.
    """
    if not 0 <= port < 65536:
        raise ListenError(f"cannot listen on {shown_address(host, port)}: --port is a number from 1 to 65535")
    try:
        name = host.strip("[]") or None
        found = socket.getaddrinfo(name, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE)
        family, *_, address = min(found, key=lambda one: one[0] != socket.AF_INET)  # IPv4, if a name has both
        listener = kind(family, socket.SOCK_STREAM)
        try:
            listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            listener.bind(address)
            listener.listen(16)
        except OSError:
            listener.close()
            raise
    except (OSError, ValueError) as error:  # ValueError: an invalid name of a host
        reason = getattr(error, "strerror", None) or error
        advice = "give an address of this machine by --host"
        if getattr(error, "errno", None) in (errno.EADDRINUSE, errno.EACCES):
            advice = "end the bc-drive or bc-record listen that is running there, or give another --port"
        raise ListenError(f"cannot listen on {shown_address(host, port)} ({reason}); {advice}") from None
    return listener
