"""The live server: this computer only, no stranger, never waits, ends with its process and frees its port."""

import contextlib
import http.client
import os
import signal
import socket
import subprocess
import sys
import threading
import time

import psutil
import pytest

from calib.core.base.errors import InputError
from tests.child_programs import start
from viz.server import PageServer


@pytest.fixture
def server():
    served = PageServer("<p>page ü</p>")
    yield served
    served.close()


def get(server, path, host=None, method="GET", **headers):
    connection = http.client.HTTPConnection("127.0.0.1", server.port, timeout=30)
    try:
        connection.request(method, path, headers=headers if host is None else {"Host": host, **headers})
        answer = connection.getresponse()
        return answer.status, answer.read()
    finally:
        connection.close()


def path_of(server):
    return server.url.split(str(server.port), 1)[1]


@pytest.fixture
def listen(server):
    """Connect like a browser that listens to events; what stays open is closed, so that a failure leaves no socket."""
    opened = []

    def connect():
        connection = socket.create_connection(("127.0.0.1", server.port), timeout=30)
        opened.append(connection)
        connection.sendall(f"GET {path_of(server)}events HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n\r\n".encode())
        received = b""
        while b"\r\n\r\n" not in received:
            received += connection.recv(4096)
        return connection, received.split(b"\r\n\r\n", 1)[1]

    yield connect
    for connection in opened:
        connection.close()


def read_until(connection, received, expected):
    while expected not in received:
        received += connection.recv(4096)
    return received


def until(condition, seconds=30.0):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    return condition()


def test_it_listens_on_this_computer_only(server):
    listening = [c.laddr for c in psutil.Process().net_connections("inet") if c.status == psutil.CONN_LISTEN]
    assert {place.ip for place in listening if place.port == server.port} == {"127.0.0.1"}


def test_it_serves_the_page_to_whom_the_address_is_known(server):
    assert get(server, path_of(server)) == (200, "<p>page ü</p>".encode())
    escapes = "../../etc/passwd", "..%2f..%2fetc/passwd", "%2e%2e/", "./", "?", "events/../", "\\..\\", "a/../events"
    for path in escapes:
        assert get(server, path_of(server) + path)[0] == 404
    for path in ("/", "/events", "//etc/passwd", "/../..//etc/passwd", "*", path_of(server)[:-2] + "/"):
        assert get(server, path)[0] == 404
    other = PageServer("")
    assert path_of(server) != path_of(other)
    other.close()


def raw(server, request):
    """Answer to bytes as they are."""
    with socket.create_connection(("127.0.0.1", server.port), timeout=30) as connection:
        with contextlib.suppress(ConnectionError):  # a server that has read enough hangs up
            connection.sendall(request)
        received = b""
        with contextlib.suppress(ConnectionError):
            while part := connection.recv(4096):
                received += part
        return received


def test_requests_in_the_name_of_another_host_are_refused(server):
    """A stranger's name that points to this computer (DNS rebinding) gets nothing, whatever else the request says."""
    mine = f"127.0.0.1:{server.port}"
    for host in ("evil.example", f"evil.example:{server.port}", "127.0.0.1", f"127.0.0.1.evil.example:{server.port}",
                 f"0.0.0.0:{server.port}", f"[::1]:{server.port}", mine + "@evil.example", ""):  # fmt: skip
        for path in ("", "events"):
            assert get(server, path_of(server) + path, host=host)[0] == 403
    head = f"GET {path_of(server)} HTTP/1.1\r\n".encode()
    assert b" 403 " in raw(server, head + b"\r\n")
    assert b" 403 " in raw(server, head + f"Host: {mine}\r\nHost: evil.example\r\n\r\n".encode())
    assert get(server, path_of(server), host=f"localhost:{server.port}")[0] == 200


def test_requests_that_another_page_makes_are_refused(server):
    for origin in ("http://evil.example", "null", f"https://127.0.0.1:{server.port}", "http://127.0.0.1", "file://"):
        assert get(server, path_of(server), Origin=origin)[0] == 403
        assert get(server, path_of(server) + "events", Origin=origin)[0] == 403
    assert get(server, path_of(server), Origin=f"http://127.0.0.1:{server.port}")[0] == 200


def test_no_web_socket_is_opened_and_nothing_is_taken_in(server):
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Version": "13"}
    key = {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ=="}
    assert get(server, path_of(server), Origin="http://evil.example", **upgrade, **key)[0] == 403
    assert get(server, path_of(server), **upgrade, **key)[0] == 200  # the page, as to everybody who knows the address
    for method in ("POST", "PUT", "DELETE", "OPTIONS", "CONNECT"):
        assert get(server, path_of(server), method=method)[0] == 501


def test_a_request_without_end_is_cut_off(server):
    assert b" 414 " in raw(server, b"GET /" + b"a" * 200_000)
    head = f"GET {path_of(server)} HTTP/1.1\r\nHost: 127.0.0.1:{server.port}\r\n".encode()
    assert b" 431 " in raw(server, head + b"X: " + b"a" * 200_000)
    assert b" 431 " in raw(server, head + b"X: a\r\n" * 1000)
    assert get(server, path_of(server))[0] == 200


@pytest.mark.quick(0)
def test_only_so_many_are_served_at_once(server, listen, monkeypatch):
    monkeypatch.setattr("viz.server._Handler.timeout", 0.2)  # seconds that a silent connection may stay
    first, _ = listen()
    held = [socket.create_connection(("127.0.0.1", server.port), timeout=30) for _ in range(100)]
    try:
        assert get(server, path_of(server))[0] == 200  # who says nothing keeps nobody out
        with contextlib.suppress(ConnectionError):
            assert held[0].recv(1) == b""  # hung up to make room
        assert until(lambda: threading.active_count() <= 40, 30)
        server.send("pose", "1")
        assert b"data: 1" in read_until(first, b"", b"data: 1\n\n")  # who was here is served
    finally:
        for connection in held:
            connection.close()


def test_where_all_are_served_another_one_is_turned_away(server, listen, monkeypatch):
    monkeypatch.setattr("viz.server._CLIENTS", 3)
    for _ in range(3):
        listen()
    another = socket.create_connection(("127.0.0.1", server.port), timeout=30)
    with another, contextlib.suppress(ConnectionError):
        assert another.recv(1) == b""
    assert server.n_browsers == 3


def test_messages_reach_every_browser_and_later_ones_get_the_state(server, listen):
    first, received = listen()
    assert server.wait_for_browser(30)
    server.send("pose", "1", keep="pose")
    server.send("pose", "2", keep="pose")
    server.send("note", "gone")
    assert b"data: gone" in read_until(first, received, b"data: gone\n\n")
    second, received = listen()
    received = read_until(second, received, b"data: 2\n\n")
    assert b"data: 1" not in received
    assert b"gone" not in received


def test_forgotten_messages_are_not_sent(server, listen):
    server.send("pose", "a", keep="pose")
    server.send("told", "b", keep="told")
    server.forget("pose")
    connection, received = listen()
    assert b"data: a" not in read_until(connection, received, b"data: b\n\n")


def test_a_closed_browser_is_noticed_and_never_waited_for(server, listen):
    connection, _ = listen()
    assert until(lambda: server.n_browsers == 1)
    connection.close()
    started = time.monotonic()
    for pose in range(20000):
        server.send("pose", str(pose))
    assert time.monotonic() - started < 5
    assert until(lambda: server.n_browsers == 0)


def test_a_browser_that_does_not_read_is_dropped(server, listen):
    listen()
    assert until(lambda: server.n_browsers == 1)
    for _ in range(60):  # 6 MB, as fast as the server can pass it on: whether it can must not matter
        for _ in range(100):
            server.send("pose", "x" * 1000)
        time.sleep(0.01)
    assert until(lambda: server.n_browsers == 0)


def test_closing_frees_the_port_and_may_be_repeated(server, listen):
    port = server.port
    connection, _ = listen()
    server.close()
    server.close()
    connection.settimeout(30)
    assert connection.recv(10) == b""
    server.send("pose", "1")  # goes nowhere
    again = PageServer("", port)
    again.close()


def test_a_taken_port_is_an_error_that_says_so(server):
    with pytest.raises(InputError, match=f"port {server.port} cannot be used"):
        PageServer("", server.port)
    with pytest.raises(InputError, match="port 99999"):
        PageServer("", 99999)


@pytest.mark.parametrize("end", ["SIGTERM", "SIGKILL", "_exit"])
def test_it_ends_with_its_process(end):
    program = "import os, sys\nfrom viz.server import PageServer\nserver = PageServer('x')\n"
    program += "print(server.port, flush=True)\nsys.stdin.readline()\nos._exit(3)"
    process = start([sys.executable, "-c", program], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        port = int(process.stdout.readline())
        socket.create_connection(("127.0.0.1", port), timeout=30).close()
        if end == "_exit":
            process.stdin.write("\n")
            process.stdin.flush()
        else:
            os.kill(process.pid, getattr(signal, end))
        process.wait(10)
        with pytest.raises(ConnectionRefusedError):
            socket.create_connection(("127.0.0.1", port), timeout=30)
        PageServer("", port).close()
    finally:
        process.kill()
        process.wait()
        process.stdin.close()
        process.stdout.close()
