"""The HTTP server of the page, and the guard that refuses requests of other pages.

A web page from anywhere can make a browser send requests to this machine. Such a request names
another origin or, if a domain name was made to resolve to this machine, another host.
"""

import contextlib
import ipaddress
import socket
from collections.abc import Callable

import uvicorn
from starlette.datastructures import Headers, MutableHeaders
from starlette.responses import PlainTextResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send
from starlette.websockets import WebSocketClose

from skyline import InputError
from skyline.web.app import PageApp
from skyline.web.engine import Engine

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
_MAX_MESSAGE_BYTES = 1_000_000
_ENDS_S = 3


def serve(make_engine: Callable[[], Engine], host: str, port: int) -> None:
    """Serve the page of an engine until Ctrl-C; port 0 takes any that is free.

    Raises `InputError` if the address cannot be listened on, and what making the engine raises.
    """
    with contextlib.suppress(KeyboardInterrupt), contextlib.ExitStack() as opened:
        # Connections from now on wait until the server is ready.
        listening = opened.enter_context(_listening(host, port))
        port = listening.getsockname()[1]
        engine = opened.enter_context(contextlib.closing(make_engine()))
        config = uvicorn.Config(
            Guard(PageApp(engine, lambda: _print_ready(host, port)).app(), host, port),
            log_level="warning",
            access_log=False,
            server_header=False,
            ws_max_size=_MAX_MESSAGE_BYTES,
            timeout_graceful_shutdown=_ENDS_S,
        )
        uvicorn.Server(config).run(sockets=[listening])


def _print_ready(host: str, port: int) -> None:
    """Print the page's address; from here on Ctrl-C ends the server."""
    name = f"[{host}]" if ":" in host else host
    with contextlib.suppress(BrokenPipeError):  # The server goes on if its output is closed.
        print(f"The page is at http://{name}:{port}/ (Ctrl-C ends it)", flush=True)


def _listening(host: str, port: int) -> socket.socket:
    is_v6 = ":" in host
    family = socket.AF_INET6 if is_v6 else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, dualstack_ipv6=is_v6)
    except OSError as error:
        raise InputError(
            f"{host} port {port} cannot be listened on ({error}); name another with --port"
        ) from error


class Guard:
    """Refuses requests with a foreign host or from a foreign origin.

    The server listens on ``host`` and ``port``.
    """

    def __init__(self, app: ASGIApp, host: str, port: int) -> None:
        self._app, self._port = app, port
        self._names = set(_LOOPBACK)
        address = _address(host)
        self._open = host != "localhost" and (address is None or not address.is_loopback)
        if self._open:
            self._names |= {host.lower(), socket.gethostname().lower(), socket.getfqdn().lower()}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass the page's own requests on, and answer others with 403."""
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
        """Return whether a request with these Host and Origin headers is from the page itself."""
        if len(hosts) != 1 or not self._is_ours(hosts[0]):
            return False
        return all(origin == f"http://{hosts[0]}" for origin in origins)

    def _is_ours(self, host: str) -> bool:
        name, colon, port = host.lower().rpartition(":")
        if not colon or port != str(self._port):
            return False
        # A foreign name can resolve to this machine; a numeric address cannot.
        return name in self._names or (self._open and _address(name) is not None)


def _address(name: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(name.strip("[]"))
    except ValueError:
        return None
