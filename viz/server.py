"""A web server for one page, on this computer only, inside this process.

meshcat's own server listens on every network interface, runs as a separate process that outlives its parent, and its
calls wait for ever when it is gone. Here the server is a thread: the end of the process, even by SIGKILL, ends the
server and frees its port. It listens on 127.0.0.1, under a secret address. It answers only requests that name this
address as their host and come from no other page, so that no web page elsewhere can read it, even by a host name that
resolves to this address. It reads only the head of a GET, whose length is limited, and serves a limited number of
connections: if more come, the oldest connection that has sent no request is closed, so that silent connections keep no
browser out.

Messages go to browsers as server-sent events. Each browser has a queue: sending never waits, and a browser that is
closed or does not read is dropped. The system's buffer for a browser is small, so that the queue shows whether the
browser reads; by default, it takes megabytes of unread messages.
"""

from __future__ import annotations

import contextlib
import queue
import secrets
import socket
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

from calib.core.base.errors import InputError

ADDRESS = "127.0.0.1"
_WAITING = 4096  # unread messages of a slow browser before it is dropped
_SYSTEM_BUFFER = 1 << 17  # approximate bytes that the system may keep for a browser; it takes up to twice as many
_HEARTBEAT = 5.0  # seconds between signs of life, which notice a closed browser
_PATIENCE = 10.0  # seconds that one write or read may take
_CLIENTS = 32  # connections at once; each has a thread and a queue


class PageServer:
    """Serve a page (HTML) and send messages to its readers; port 0 is any free port.

    Raises:
        InputError: The port is taken, or not allowed.
    """

    def __init__(self, page: str, port: int = 0) -> None:
        self._page = page.encode("utf-8")
        self._token = secrets.token_urlsafe(16)
        self._browsers: set[queue.Queue[bytes | None]] = set()
        self._state: dict[str, bytes] = {}
        self._lock = threading.Lock()
        self._connected = threading.Event()
        self.closed = False
        try:
            self._server = _Server((ADDRESS, port), _Handler)
        except (OSError, OverflowError) as error:
            raise InputError(
                f"port {port} cannot be used ({error}); choose another one, or 0 for any free port"
            ) from None
        self._server.owner = self
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), name="viewer", daemon=True)
        self._thread.start()

    @property
    def port(self) -> int:
        """Port that the server listens on."""
        return int(self._server.server_address[1])

    @property
    def url(self) -> str:
        """Address to open in a browser on this computer."""
        return f"http://{ADDRESS}:{self.port}/{self._token}/"

    @property
    def n_browsers(self) -> int:
        """Number of connected browsers."""
        with self._lock:
            return len(self._browsers)

    def send(self, event: str, data: str, keep: str | None = None) -> None:
        """Send a message of one line to every browser, without waiting.

        Under `keep`, it is kept for later browsers, in place of an earlier one.
        """
        message = f"event: {event}\ndata: {data}\n\n".encode()
        with self._lock:
            if keep is not None:
                self._state.pop(keep, None)
                self._state[keep] = message
            for browser in list(self._browsers):
                try:
                    browser.put_nowait(message)
                except queue.Full:
                    self._browsers.discard(browser)

    def replace(self, page: str) -> None:
        """Serve another page from now on, and have every browser load it."""
        self._page = page.encode("utf-8")
        self.send("reload", "now")

    def forget(self, key: str) -> None:
        """Drop the message kept under this key."""
        with self._lock:
            self._state.pop(key, None)

    def wait_for_browser(self, timeout: float) -> bool:
        """Wait for a connection from a browser, at most `timeout` seconds; return whether there is one."""
        return self._connected.wait(timeout)

    def close(self) -> None:
        """Stop serving and free the port; browsers keep the picture. Further calls do nothing."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
            for browser in self._browsers:
                with contextlib.suppress(queue.Full):  # then its thread sends what is queued, and ends
                    browser.put_nowait(None)
            self._browsers.clear()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(_PATIENCE)

    def answer(self, handler: BaseHTTPRequestHandler) -> None:
        """Answer one request."""
        hosts = (f"{ADDRESS}:{self.port}", f"localhost:{self.port}")
        named = handler.headers.get_all("Host", [])
        origin = handler.headers.get("Origin")  # absent if a browser opens the address itself
        if len(named) != 1 or named[0] not in hosts or origin not in (None, *(f"http://{host}" for host in hosts)):
            handler.send_error(403)
        elif handler.path == f"/{self._token}/":
            self._send_page(handler)
        elif handler.path == f"/{self._token}/events":
            self._send_events(handler)
        else:
            handler.send_error(404)

    def _send_page(self, handler: BaseHTTPRequestHandler) -> None:
        handler.send_response(200)
        handler.send_header("Content-Type", "text/html; charset=utf-8")
        handler.send_header("Content-Length", str(len(self._page)))
        handler.send_header("Cache-Control", "no-store")
        handler.send_header("Referrer-Policy", "no-referrer")
        handler.send_header("X-Content-Type-Options", "nosniff")
        handler.end_headers()
        handler.wfile.write(self._page)

    def _send_events(self, handler: BaseHTTPRequestHandler) -> None:
        handler.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SYSTEM_BUFFER)
        browser: queue.Queue[bytes | None] = queue.Queue(_WAITING)
        with self._lock:
            if self.closed:
                return
            waiting = list(self._state.values())
            self._browsers.add(browser)
        try:
            handler.send_response(200)
            handler.send_header("Content-Type", "text/event-stream")
            handler.send_header("Cache-Control", "no-store")
            handler.end_headers()
            for message in waiting:
                handler.wfile.write(message)
            handler.wfile.flush()
            self._connected.set()
            while browser in self._browsers:
                try:
                    following = browser.get(timeout=_HEARTBEAT)
                except queue.Empty:
                    following = b": still here\n\n"
                if following is None:
                    return
                handler.wfile.write(following)
                handler.wfile.flush()
        finally:
            with self._lock:
                self._browsers.discard(browser)


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False
    owner: PageServer

    def __init__(self, address: tuple[str, int], handler: type[BaseHTTPRequestHandler]) -> None:
        self._silent: dict[socket.socket, None] = {}  # connections without a request yet, the oldest first
        self._known: set[socket.socket] = set()  # connections with a request
        self._places = threading.Lock()
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a new thread, or hang up if there are too many connections."""
        with self._places:
            if len(self._silent) + len(self._known) >= _CLIENTS and self._silent:
                oldest = next(iter(self._silent))
                del self._silent[oldest]
                with contextlib.suppress(OSError):  # its thread reads the end, and leaves
                    oldest.shutdown(socket.SHUT_RDWR)
            room = len(self._silent) + len(self._known) < _CLIENTS
            if room:
                self._silent[request] = None
        if room:
            super().process_request(request, client_address)
        else:
            self.shutdown_request(request)

    def has_spoken(self, request: socket.socket) -> None:
        """Record that a connection has sent the head of its request."""
        with self._places:
            if request in self._silent:
                del self._silent[request]
                self._known.add(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and make room for another connection."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self._places:
                self._silent.pop(request, None)
                self._known.discard(request)

    def handle_error(self, request: object, client_address: object) -> None:
        """Print nothing: a browser that went away is no error."""


class _Handler(BaseHTTPRequestHandler):
    timeout = _PATIENCE
    server: _Server

    def parse_request(self) -> bool:
        """Read the head of a request."""
        understood = super().parse_request()
        self.server.has_spoken(self.connection)
        return understood

    def do_GET(self) -> None:
        """Answer a request for the page or its events."""
        self.server.owner.answer(self)

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""
