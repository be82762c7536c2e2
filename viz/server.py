"""A web server for one page, on this computer only, inside this process.

meshcat's own server listens on every network interface, runs as a separate process that outlives its parent, and its
calls wait for ever when it is gone. Here the server is a thread: whatever ends the process, SIGKILL included, ends
the server and frees its port. It listens on 127.0.0.1, under an address that cannot be guessed, and answers only
requests that name this address as their host, so that no web page elsewhere can read it, also not by a name that it
lets point here; nor one that says it comes from another page. Nothing is ever read from a browser but the head of a
GET, which has an end, and only so many are served at once: where more come, who was there first and has still not said
what it wants makes room, so that silent connections keep no one out.

Messages go to browsers as server-sent events. Each browser has a queue of its own: sending never waits, and a browser
that is closed or does not read is dropped. So that its queue shows whether it reads, the system may keep little for it:
left alone, it takes megabytes of messages that are not read.
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
_WAITING = 4096  # messages that a slow browser may have before it is dropped
_SYSTEM_BUFFER = 1 << 17  # bytes that the system may keep for a browser, about; it takes up to twice as many
_HEARTBEAT = 5.0  # seconds between signs of life, which notice a closed browser
_PATIENCE = 10.0  # seconds that one write or read may take
_CLIENTS = 32  # connections at once; each has a thread and a queue


class PageServer:
    """Serve a page and send messages to its readers.

    Args:
        page: The HTML.
        port: Port to listen on; 0 for any free one.

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
        """How many browsers are connected."""
        with self._lock:
            return len(self._browsers)

    def send(self, event: str, data: str, keep: str | None = None) -> None:
        """Send a message to every browser, without waiting.

        Args:
            event: Kind of message.
            data: One line of text.
            keep: Under this key the message is kept for browsers that come later; a later one replaces it.
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
        """Drop the message that is kept under this key."""
        with self._lock:
            self._state.pop(key, None)

    def wait_for_browser(self, timeout: float) -> bool:
        """Wait until a browser has connected, at most `timeout` seconds; say whether one has."""
        return self._connected.wait(timeout)

    def close(self) -> None:
        """Stop serving and free the port. Browsers keep the picture. Closing twice is fine."""
        with self._lock:
            if self.closed:
                return
            self.closed = True
            for browser in self._browsers:
                with contextlib.suppress(queue.Full):  # a full queue is noticed when it has been read
                    browser.put_nowait(None)
            self._browsers.clear()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join(_PATIENCE)

    def answer(self, handler: BaseHTTPRequestHandler) -> None:
        """Answer one request."""
        hosts = (f"{ADDRESS}:{self.port}", f"localhost:{self.port}")
        named = handler.headers.get_all("Host", [])
        origin = handler.headers.get("Origin")  # a browser that opens an address says none
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
        self._silent: dict[socket.socket, None] = {}  # connections that have said nothing yet, the oldest first
        self._known: set[socket.socket] = set()  # those that have
        self._places = threading.Lock()
        super().__init__(address, handler)

    def process_request(self, request: Any, client_address: Any) -> None:
        """Answer in a thread of its own, or hang up if too many are served."""
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
        """Say that a connection has sent the head of its request."""
        with self._places:
            if request in self._silent:
                del self._silent[request]
                self._known.add(request)

    def process_request_thread(self, request: Any, client_address: Any) -> None:
        """Answer, and make room for another one."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            with self._places:
                self._silent.pop(request, None)
                self._known.discard(request)

    def handle_error(self, request: object, client_address: object) -> None:
        """A browser that went away is no error; nothing is printed."""


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
