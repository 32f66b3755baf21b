"""Who may look through the window: a real gate before a real server."""

import http.client
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from footfall.messages.config import ConfigError
from footfall.nodes.viewer import read_token
from footfall.nodes.viewer_gate import Gate
from footfall.nodes.viewer_server import Window

TOKEN = "a" * 20


class Hello(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"hello " + self.path.encode())

    def log_message(self, format: str, *args: object) -> None:
        pass


@pytest.fixture
def inner() -> Iterator[int]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Hello)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server.server_address[1]
    server.shutdown()
    thread.join()
    server.server_close()


def ask(gate: Gate, path: str = "/", **headers: str) -> tuple[int, str, dict[str, str]]:
    connection = http.client.HTTPConnection("127.0.0.1", gate.port, timeout=5)
    connection.request("GET", path, headers=headers)
    answer = connection.getresponse()
    body = answer.read().decode()
    connection.close()
    return answer.status, body, dict(answer.headers)


@pytest.fixture
def gate(inner: int) -> Iterator[Gate]:
    gate = Gate("127.0.0.1", 0, inner)
    yield gate
    gate.close()


@pytest.fixture
def locked(inner: int) -> Iterator[Gate]:
    gate = Gate("127.0.0.1", 0, inner, TOKEN)
    yield gate
    gate.close()


def test_on_loopback_one_s_own_browser_passes(gate):
    assert ask(gate, "/x") == (200, "hello /x", ask(gate, "/x")[2])
    host = f"127.0.0.1:{gate.port}"
    assert ask(gate, Origin=f"http://{host}", Host=host)[0] == 200


def test_pages_from_elsewhere_are_turned_away_even_on_loopback(gate):
    assert ask(gate, Origin="https://evil.example")[0] == 403
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Origin": "https://evil.example"}
    assert ask(gate, **upgrade)[0] == 403
    assert ask(gate, Host=f"evil.example:{gate.port}")[0] == 403  # a name that was bent to lead here
    assert gate.refused == 3


def test_without_the_token_nothing_passes(locked):
    assert ask(locked)[0] == 401
    assert ask(locked, "/?token=wrong")[0] == 401
    assert ask(locked, Cookie="footfall-token=wrong")[0] == 401
    assert ask(locked, Upgrade="websocket", Connection="Upgrade")[0] == 401


def test_the_token_is_remembered_as_a_cookie_that_scripts_cannot_read(locked):
    status, _, headers = ask(locked, f"/?token={TOKEN}")
    assert status == 303 and headers["Location"] == "/"
    cookie = headers["Set-Cookie"]
    assert "HttpOnly" in cookie and "SameSite=Strict" in cookie
    assert ask(locked, "/y", Cookie=cookie.partition(";")[0])[:2] == (200, "hello /y")
    assert TOKEN in locked.url and TOKEN not in locked.public_url


def test_every_request_of_a_connection_is_judged(gate):
    connection = http.client.HTTPConnection("127.0.0.1", gate.port, timeout=5)
    connection.request("GET", "/", headers={"Connection": "keep-alive"})
    assert connection.getresponse().read() == b"hello /"
    connection.request("GET", "/", headers={"Origin": "https://evil.example"})  # on a new connection
    assert connection.getresponse().status == 403
    connection.close()


def test_an_open_address_needs_a_token_and_a_free_port(inner):
    with pytest.raises(ConfigError, match="needs a token"):
        Window("0.0.0.0", 0, "x")
    with pytest.raises(ConfigError, match="cannot listen"):
        Window("127.0.0.1", inner, "x")


def test_the_token_file_must_be_private_and_hold_a_token(tmp_path):
    file = tmp_path / "token"
    file.write_text(TOKEN)
    file.chmod(0o644)
    with pytest.raises(ConfigError, match="chmod 600"):
        read_token(str(file))
    file.chmod(0o600)
    assert read_token(str(file)) == TOKEN
    file.write_text("short")
    with pytest.raises(ConfigError, match="16 or more"):
        read_token(str(file))
    with pytest.raises(ConfigError, match="nowhere"):
        read_token(str(tmp_path / "nowhere"))
