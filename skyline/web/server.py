"""The page's HTTP server, and the guard against other pages' requests.

A web page from anywhere can make a browser send requests to this machine. Such a request names
another origin or, if a domain name was made to resolve to this machine, another host.
"""

import contextlib
import ipaddress
import socket
from collections.abc import Callable
from dataclasses import dataclass

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
_FAMILIES = {4: (socket.AF_INET, "192.0.2.1"), 6: (socket.AF_INET6, "2001:db8::1")}
"""For each version of IP: its sockets, and an address in the networks reserved for
documentation."""
_MAX_MESSAGE_BYTES = 1_000_000
_ENDS_S = 3


def serve(make_engine: Callable[[], Engine], host: str, port: int) -> None:
    """Serve the page of an engine until Ctrl-C.

    Port 0 takes any free port.

    Raises `InputError` if the address cannot be listened on, and what making the engine raises.
    """
    with contextlib.suppress(KeyboardInterrupt), contextlib.ExitStack() as opened:
        # Connections from now on wait until the server is ready.
        listening = opened.enter_context(_listening(host, port))
        address, port = listening.getsockname()[:2]
        reach = Reach.of(host, address)
        engine = opened.enter_context(contextlib.closing(make_engine()))
        app = PageApp(engine, reach.machine, lambda: _print_ready(reach.in_words(port)))
        config = uvicorn.Config(
            Guard(app.app(), host, port),
            log_level="warning",
            access_log=False,
            server_header=False,
            ws_max_size=_MAX_MESSAGE_BYTES,
            timeout_graceful_shutdown=_ENDS_S,
        )
        uvicorn.Server(config).run(sockets=[listening])


@dataclass(frozen=True)
class Reach:
    """The hosts by which browsers reach the page.

    Attributes
    ----------
    here : str
        A host that opens the page on this machine.
    elsewhere : tuple of str
        Hosts that open it on other machines; none if only this machine can open it.
    machine : str or None
        The name of this machine, where photos of other machines go; None if there are none.
    """

    here: str
    elsewhere: tuple[str, ...] = ()
    machine: str | None = None

    @classmethod
    def of(cls, host: str, address: str) -> "Reach":
        """Return the reach of a server that listens on an address."""
        listens = ipaddress.ip_address(address)
        if listens.is_loopback:
            return cls(host)
        if not listens.is_unspecified:
            return cls(host, (host,), socket.gethostname())
        loopback = "::1" if listens.version == 6 else "127.0.0.1"
        # A server that listens on all addresses of IPv6 listens on all of IPv4, too.
        versions = (4, 6) if listens.version == 6 else (4,)
        own = [one for version in versions for one in own_addresses(version)]
        return cls(loopback, tuple(own) or (socket.gethostname(),), socket.gethostname())

    def in_words(self, port: int) -> str:
        """Return the line that says where the page is."""

        def url(host: str) -> str:
            return f"http://[{host}]:{port}/" if ":" in host else f"http://{host}:{port}/"

        words = f"The page is at {url(self.here)}"
        others = [url(one) for one in self.elsewhere if one != self.here]
        if others:
            words += f" on this machine, and at {', '.join(others)} on others"
        return f"{words} (Ctrl-C ends it)"


def own_addresses(version: int) -> list[str]:
    """Return the addresses by which other machines reach this one.

    They are of one version of IP; there may be none. The first belongs to the route to other
    networks.
    """
    family, elsewhere = _FAMILIES[version]
    found = []
    with socket.socket(family, socket.SOCK_DGRAM) as routed, contextlib.suppress(OSError):
        routed.connect((elsewhere, 9))  # Nothing is sent.
        found.append(routed.getsockname()[0])
    with contextlib.suppress(OSError):
        found += [str(one[4][0]) for one in socket.getaddrinfo(socket.gethostname(), None, family)]
    addresses = [ipaddress.ip_address(one) for one in found]
    return list(
        dict.fromkeys(str(one) for one in addresses if not (one.is_loopback or one.is_link_local))
    )


def _print_ready(words: str) -> None:
    with contextlib.suppress(BrokenPipeError):  # The server goes on if its output is closed.
        print(words, flush=True)


def _listening(host: str, port: int) -> socket.socket:
    is_v6 = ":" in host
    family = socket.AF_INET6 if is_v6 else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family, dualstack_ipv6=is_v6)
    except OSError as error:
        raise InputError(
            f"{host} port {port} cannot be listened on ({error}); name another port with --port, "
            "or an address of this machine with --host"
        ) from error


class Guard:
    """Refuses requests with a foreign host or from a foreign origin.

    The server listens on ``host`` and ``port``.
    """

    def __init__(self, app: ASGIApp, host: str, port: int) -> None:
        self._app = app
        self._port = port
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
        """Return whether these Host and Origin headers are the page's own."""
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
