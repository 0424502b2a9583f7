"""An HTTP server on the loopback address that serves ranges of files, and misbehaves on request."""

import multiprocessing
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from multiprocessing.connection import Connection
from typing import NamedTuple


@dataclass
class Behaviour:
    """Answers of the server by path, which begins with a slash, and the requests so far."""

    files: dict[str, bytes] = field(default_factory=dict)
    # Paths that are answered with a status instead, always.
    status: dict[str, int] = field(default_factory=dict)
    failures: int = 0  # Requests that are answered with a status before the first good answer
    failing: int = 500
    failing_get: int = 0  # As failures, of requests of bodies alone
    delay_s: float = 0.0  # Before every answer
    truncate: int = 0  # Bodies that break off half way, though header and connection promise all
    drip_s: float = 0.0  # After every byte of a body
    posted: list[str] = field(default_factory=list)
    # (method, path, range header) each.
    requests: list[tuple[str, str, str | None]] = field(default_factory=list)
    sent: int = 0  # Bytes of bodies
    stopping: threading.Event = field(default_factory=threading.Event)


class _Handler(BaseHTTPRequestHandler):
    protocol_version = "HTTP/1.1"
    server: "_Server"

    def do_GET(self) -> None:
        behaviour, path = self.server.behaviour, self.path
        behaviour.requests.append((self.command, path, self.headers.get("Range")))
        if behaviour.delay_s:
            behaviour.stopping.wait(behaviour.delay_s)
        if behaviour.failures > 0:
            behaviour.failures -= 1
            self._refuse(behaviour.failing)
        elif behaviour.failing_get > 0 and self.command == "GET":
            behaviour.failing_get -= 1
            self._refuse(503)
        elif path in behaviour.status:
            self._refuse(behaviour.status[path])
        elif path not in behaviour.files:
            self._refuse(404)
        else:
            self._send(behaviour, behaviour.files[path])

    do_HEAD = do_GET  # noqa: N815

    def do_POST(self) -> None:
        posted = self.rfile.read(int(self.headers["Content-Length"])).decode()
        self.server.behaviour.posted.append(posted)
        self.do_GET()

    def _refuse(self, status: int) -> None:
        body = b"<html>no</html>"
        self.send_response(status)
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command != "HEAD":
            self.wfile.write(body)

    def _send(self, behaviour: Behaviour, content: bytes) -> None:
        asked = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range") or "")
        first, last = (int(part or len(content)) for part in asked.groups()) if asked else (0, None)
        body = content[first:][: None if last is None else last - first + 1]
        last = first + len(body) - 1
        if asked and not body:
            self._refuse(416)
            return
        self.send_response(206 if asked else 200)
        self.send_header("Accept-Ranges", "bytes")
        if asked:
            self.send_header("Content-Range", f"bytes {first}-{last}/{len(content)}")
        self.send_header("Content-Length", str(len(body)))
        self.end_headers()
        if self.command == "HEAD":
            return
        if behaviour.truncate > 0:
            behaviour.truncate -= 1
            body = body[: len(body) // 2]
            self.close_connection = True
        behaviour.sent += len(body)
        if not behaviour.drip_s:
            self.wfile.write(body)
            return
        for byte in body:
            self.wfile.write(bytes([byte]))
            if behaviour.stopping.wait(behaviour.drip_s):
                return

    def log_message(self, *_: object) -> None:
        """Print nothing."""


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    behaviour: Behaviour

    def handle_error(self, request: object, client_address: object) -> None:
        """Print nothing about clients that went away."""


@contextmanager
def serve(behaviour: Behaviour) -> Iterator[str]:
    """Serve on a free port of 127.0.0.1; yields the address without a final slash."""
    server = _Server(("127.0.0.1", 0), _Handler)
    server.behaviour = behaviour
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_port}"
    finally:
        behaviour.stopping.set()
        server.shutdown()
        server.server_close()
        thread.join()


class Apart(NamedTuple):
    """A server in another process; ``asked()`` returns its requests since the last call."""

    address: str
    asked: Callable[[], list[tuple[str, str, str | None]]]


@contextmanager
def serve_apart(files: Callable[[str], dict[str, bytes]]) -> Iterator[Apart]:
    """Serve ``files(address)`` from another process: GDAL blocks all threads while it waits."""
    spawn = multiprocessing.get_context("spawn")
    here, there = spawn.Pipe()
    process = spawn.Process(target=_serve_for, args=(files, there), daemon=True)
    process.start()
    address = here.recv()

    def asked():
        here.send(None)
        return here.recv()

    try:
        yield Apart(address, asked)
    finally:
        process.terminate()
        process.join()
        process.close()


def _serve_for(files: Callable[[str], dict[str, bytes]], pipe: Connection) -> None:
    behaviour = Behaviour()
    with serve(behaviour) as address:
        behaviour.files |= files(address)
        pipe.send(address)
        while True:
            pipe.recv()
            pipe.send(behaviour.requests)
            behaviour.requests = []
