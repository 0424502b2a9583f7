"""Who may ask the server, and what answers tell a browser: a page elsewhere gets nothing.

A web page from anywhere can make a browser send requests to this machine. Such a request names
another origin, or, where a name was made to lead here, another host.
"""

import ipaddress
import socket

from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

_LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
_POLICY = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' blob: data:; "
        "connect-src 'self'; form-action 'none'; frame-ancestors 'none'; base-uri 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
}


class Guard:
    """Refuses requests under a foreign host or from a foreign origin.

    ``host`` and ``port`` are what the server listens on.
    """

    def __init__(self, app: ASGIApp, host: str, port: int) -> None:
        self._app, self._port = app, port
        self._names = set(_LOOPBACK)
        address = _address(host)
        self._open = host != "localhost" and (address is None or not address.is_loopback)
        if self._open:
            self._names |= {host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass on what may be asked, and answer the rest with 403."""
        if scope["type"] == "lifespan":
            await self._app(scope, receive, send)
            return
        headers = Headers(scope=scope)
        if not self.allows(headers.getlist("host"), headers.getlist("origin")):
            text = "This server answers its own page only: open the address that it printed.\n"
            is_socket = scope["type"] == "websocket"
            refusal = WebSocketClose(1008) if is_socket else PlainTextResponse(text, 403)
            await refusal(scope, receive, send)
            return

        async def with_policy(message: Message) -> None:
            if message["type"] == "http.response.start":
                MutableHeaders(scope=message).update(_POLICY)
            await send(message)

        await self._app(scope, receive, with_policy)

    def allows(self, hosts: list[str], origins: list[str]) -> bool:
        """Whether a request under these hosts, from these origins, is one of our page's."""
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return False
        return all(origin == f"http://{hosts[0]}" for origin in origins)

    def _is_ours(self, host: str) -> bool:
        name, colon, port = host.lower().rpartition(":")
        if not colon or port != str(self._port):
            return False
        # A number cannot be made to lead here, as a name can.
        return name in self._names or (self._open and _address(name) is not None)


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return None
