"""Serve the page, on this machine alone unless another address is named."""

import contextlib
import socket

import uvicorn

from skyline import InputError
from skyline.web.app import make_app
from skyline.web.engine import Engine, Given
from skyline.web.guard import Guard

_MAX_MESSAGE_BYTES = 1_000_000
_ENDS_S = 3


def serve(given: Given, host: str, port: int) -> None:
    """Serve the page of a store until Ctrl-C.

    Parameters
    ----------
    host : str
        The address to listen on.
    port : int
        0 takes any that is free.

    Raises
    ------
    InputError
        The address cannot be listened on.
    SkylineError
        The store cannot be used; see `Engine`.
    """
    with contextlib.suppress(KeyboardInterrupt), contextlib.ExitStack() as opened:
        listening = _listening(opened, host, port)
        port = listening.getsockname()[1]
        engine = opened.enter_context(contextlib.closing(Engine(given)))
        config = uvicorn.Config(
            Guard(make_app(engine, lambda: _say_ready(host, port)), host, port),
            log_level="warning",
            access_log=False,
            server_header=False,
            ws_max_size=_MAX_MESSAGE_BYTES,
            timeout_graceful_shutdown=_ENDS_S,
        )
        listening.listen()  # who opens the address at once must wait, and not be refused
        uvicorn.Server(config).run(sockets=[listening])


def _say_ready(host: str, port: int) -> None:
    """Say where the page is; by now the server heeds Ctrl-C."""
    name = f"[{host}]" if ":" in host else host
    with contextlib.suppress(BrokenPipeError):  # The page is there also where nobody reads this.
        print(f"The page is at http://{name}:{port}/ (Ctrl-C ends it)", flush=True)


def _listening(opened: contextlib.ExitStack, host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        listening = opened.enter_context(socket.socket(family, kind, protocol))
        listening.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listening.bind(address)
    except OSError as error:
        raise InputError(
            f"{host} port {port} cannot be listened on ({error}); name another with --port"
        ) from error
    return listening
