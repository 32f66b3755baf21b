"""The door of the viewer: passes a browser's connections on to viser, once it has seen who asks.

A browser sends its cookies and the page it comes from with every request, also with the one that opens a
web socket. Without a look at them any page in the same browser could steer the run, even on loopback.
"""

import asyncio
import contextlib
import hmac
import socket
import threading
from http.cookies import CookieError, SimpleCookie
from urllib.parse import parse_qs, urlsplit

HEAD_BYTES = 16_384
"""Longest head of a request that is read."""
HEAD_TIMEOUT = 10.0
"""Longest wait for it [s]."""
CHUNK_BYTES = 1 << 16
COOKIE = "footfall-token"


class Gate:
    """Listens at host:port and passes on to 127.0.0.1:inner what comes from a browser that may.

    Args:
        host: Address to listen at.
        port: Port; 0 takes a free one.
        inner: Port of the server behind.
        token: What the first request must name (`/?token=...`); a cookie remembers it. None asks for none.

    Raises:
        OSError: the address is taken.
    """

    def __init__(self, host: str, port: int, inner: int, token: str | None = None) -> None:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self._socket = socket.create_server((host, port), family=family)
        self.host, self.port = host, self._socket.getsockname()[1]
        self.refused = 0
        """Connections turned away so far."""
        self._inner = inner
        self._token = token
        self._open: set[asyncio.StreamWriter] = set()
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="viewer-gate", daemon=True)
        self._thread.start()

    @property
    def public_url(self) -> str:
        """The address without the token, fit for logs."""
        return self.url.partition("/?")[0]

    @property
    def url(self) -> str:
        """What to open in a browser; with an open address the name of this machine."""
        host = socket.gethostname() if self.host in ("0.0.0.0", "::") else self.host
        host = f"[{host}]" if ":" in host else host
        query = f"/?token={self._token}" if self._token else ""
        return f"http://{host}:{self.port}{query}"

    def _run(self) -> None:
        asyncio.set_event_loop(self._loop)
        self._loop.run_until_complete(self._serve())
        self._loop.close()

    async def _serve(self) -> None:
        self._stop = asyncio.Event()
        server = await asyncio.start_server(self._answer, sock=self._socket, limit=HEAD_BYTES)
        await self._stop.wait()
        server.close()
        while self._open:
            for end in tuple(self._open):
                end.transport.abort()
            await asyncio.sleep(0.01)

    def close(self) -> None:
        """Stop listening and let go of all connections."""
        if self._thread.is_alive():
            self._loop.call_soon_threadsafe(lambda: self._stop.set())
            self._thread.join(timeout=5)

    async def _answer(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """One connection: look at its first request, then pass bytes on both ways."""
        inner: asyncio.StreamWriter | None = None
        self._open.add(writer)
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), HEAD_TIMEOUT)
            answer = self.judge(head)
            if answer is not None:
                self.refused += not answer.startswith(b"HTTP/1.1 303")
                writer.write(answer)
                await writer.drain()
                return
            back, inner = await asyncio.open_connection("127.0.0.1", self._inner)
            self._open.add(inner)
            inner.write(head if _is_web_socket(head) else _closing(head))
            await asyncio.gather(_pass_on(reader, inner), _pass_on(back, writer))
        except (asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError, OSError):
            pass
        finally:
            for end in (writer, inner):
                if end is not None:
                    end.close()
                    with contextlib.suppress(OSError):
                        await end.wait_closed()
                    self._open.discard(end)

    def judge(self, head: bytes) -> bytes | None:
        """What to answer to a request's head: None lets it pass."""
        request, headers = _parse(head)
        origin = headers.get("origin")
        if origin is not None and urlsplit(origin).netloc != headers.get("host"):
            return _refusal("403 Forbidden", "This window does not open for other pages.")
        if self._token is None:
            if not _names_this_machine(headers.get("host", "")):
                return _refusal("403 Forbidden", "Open this window as http://127.0.0.1 or localhost.")
            return None
        target = urlsplit(request.split(" ")[1] if request.count(" ") == 2 else "")
        given = parse_qs(target.query).get("token", [""])[0]
        if _same(given, self._token):
            return (
                f"HTTP/1.1 303 See Other\r\nLocation: /\r\nSet-Cookie: {COOKIE}={self._token}; HttpOnly; "
                "SameSite=Strict; Path=/\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
            ).encode()
        try:
            morsel = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            morsel = None
        if morsel is not None and _same(morsel.value, self._token):
            return None
        return _refusal("401 Unauthorized", "Open the whole address that was printed, with its token.")


def _same(given: str, token: str) -> bool:
    return hmac.compare_digest(given.encode(), token.encode())


def _parse(head: bytes) -> tuple[str, dict[str, str]]:
    request, *lines = head.decode("latin-1").split("\r\n")
    pairs = (line.partition(":") for line in lines if ":" in line)
    return request, {name.strip().lower(): value.strip() for name, _, value in pairs}


def _names_this_machine(host: str) -> bool:
    """Whether a `Host` header is loopback: another name that leads here belongs to somebody else's page."""
    return urlsplit(f"//{host}").hostname in ("127.0.0.1", "localhost", "::1")


def _is_web_socket(head: bytes) -> bool:
    return _parse(head)[1].get("upgrade", "").lower() == "websocket"


def _closing(head: bytes) -> bytes:
    """A plain request that asks for one answer only, so that every request passes the gate."""
    request, *lines = head.split(b"\r\n")
    kept = [line for line in lines if line and not line.lower().startswith(b"connection:")]
    return b"\r\n".join([request, *kept, b"Connection: close", b"", b""])


def _refusal(status: str, text: str) -> bytes:
    return (
        f"HTTP/1.1 {status}\r\nContent-Type: text/plain; charset=utf-8\r\nContent-Length: {len(text)}\r\n"
        f"Connection: close\r\n\r\n{text}"
    ).encode()


async def _pass_on(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Bytes from one end to the other until it is closed; a slow receiver holds the sender back."""
    try:
        while data := await reader.read(CHUNK_BYTES):
            writer.write(data)
            await writer.drain()
    finally:
        writer.close()
