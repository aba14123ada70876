"""The check of a request's `Host` and `Origin`: web pages of other sites may not reach the server.

Any page in the user's browser can reach every port of this machine. Its requests have the page's address as
`Origin`, and as `Host` the name that the browser connected to. After DNS rebinding, this is the attacker's name,
and it leads to this machine. Numeric addresses and private names cannot be rebound.
"""

from __future__ import annotations

import ipaddress
import re
import socket
from typing import Any, Final
from urllib.parse import parse_qs

_LOOPBACK_NAMES: Final = ("localhost", "localhost.localdomain", "ip6-localhost")
_PLACE: Final = re.compile(
    r"(?:[A-Za-z][A-Za-z0-9+.-]*:)?//(?:\[(?P<address>[^\s\[\]@/]+)\]|(?P<name>[^\s\[\]@/\\?#:]+))(?::[0-9]{0,5})?/?"
)
_PRIVATE: Final = (".local", ".internal", ".home.arpa")


class AllowedHosts:
    """Allows loopback names and addresses, and the server's own `--host`.

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
