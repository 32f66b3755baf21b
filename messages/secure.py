"""Who may listen from elsewhere: CURVE keys and an explicit allow-list for everything on TCP.

CURVE alone encrypts, but lets the holder of any key pair in; the gate asks for a known one (ZAP,
https://rfc.zeromq.org/spec/27/).
"""

import logging
import os
import stat
from pathlib import Path

import msgspec
import zmq
from zmq.utils import z85

from .bus import PortError
from .graph import Security

log = logging.getLogger(__name__)

_ZAP_ADDRESS = "inproc://zeromq.zap.01"
_ZAP_DOMAIN = b"footfall"


class ClientKeys(msgspec.Struct, frozen=True):
    """What a subscriber elsewhere needs."""

    secret_key_file: str
    """Its own secret certificate."""
    server_key_file: str
    """The public certificate of the graph it listens to."""


def new_keys(directory: Path, name: str) -> tuple[Path, Path]:
    """Make a key pair: `NAME.key`, to be given away, and `NAME.key_secret`, readable by its owner only.

    Raises:
        PortError: there is a pair of that name, or the name is not a file's.
    """
    from zmq.auth import create_certificates

    if not name or Path(name).name != name:
        raise PortError(f"{name!r} cannot name a key; use letters and digits")
    for path in (directory / f"{name}.key", directory / f"{name}.key_secret"):
        if path.exists():
            raise PortError(f"{path} exists; choose another name, or remove it first")
    directory.mkdir(mode=0o700, parents=True, exist_ok=True)
    mask = os.umask(0o077)
    try:
        public, secret = create_certificates(str(directory), name)
    finally:
        os.umask(mask)
    os.chmod(public, 0o644)
    return Path(public), Path(secret)


def load_secret(path: str | Path) -> tuple[bytes, bytes]:
    """Public and secret key of a secret certificate.

    Raises:
        PortError: there is none, it is not one, or others can read it.
    """
    public, secret = _load(path)
    if secret is None:
        raise PortError(f"{path}: holds no secret key; give the file that ends in .key_secret")
    if os.stat(path).st_mode & (stat.S_IRWXG | stat.S_IRWXO):
        raise PortError(f"{path}: others may read it; run `chmod 600 {path}`")
    return public, secret


def load_public(path: str | Path) -> bytes:
    """The public key of a certificate.

    Raises:
        PortError: there is none, or it is not one.
    """
    return _load(path)[0]


def _load(path: str | Path) -> tuple[bytes, bytes | None]:
    from zmq.auth import load_certificate

    try:
        return load_certificate(str(path))
    except (OSError, ValueError) as error:
        reason = "no such file" if not Path(path).exists() else error
        raise PortError(f"{path}: not a CURVE certificate: {reason}; `footfall keys new` makes one") from None


def require_keys(what: str, address: str, security: Security | None) -> Security:
    """Whatever is exposed needs keys, on the loopback interface too: other users share it.

    Raises:
        PortError: there are none, or the address is not TCP.
    """
    if not address.startswith("tcp://"):
        raise PortError(f"{what}: cannot expose it at {address!r}; must be like tcp://0.0.0.0:7000")
    if security is None or not security.authorized_keys_dir:
        raise PortError(
            f"{what}: exposing it at {address} needs keys: set `security: {{secret_key_file: ..., "
            "authorized_keys_dir: ...}` (`footfall keys new` makes them)"
        )
    return security


def present_keys(socket: zmq.Socket, keys: ClientKeys) -> None:
    """Prepare a subscribing socket for a publisher elsewhere.

    Raises:
        PortError: a certificate cannot be used.
    """
    public, secret = load_secret(keys.secret_key_file)
    socket.setsockopt(zmq.CURVE_PUBLICKEY, public)
    socket.setsockopt(zmq.CURVE_SECRETKEY, secret)
    socket.setsockopt(zmq.CURVE_SERVERKEY, load_public(keys.server_key_file))


class Gate:
    """Lets in over TCP who is on the list: the ZAP handler of one context.

    Raises:
        PortError: a certificate cannot be used, or the list is empty.
    """

    def __init__(self, context: zmq.Context, security: Security) -> None:
        self.denied = 0
        self._public, self._secret = load_secret(security.secret_key_file)
        self._list = Path(security.authorized_keys_dir)
        if not self._allowed():
            raise PortError(f"{self._list}: holds no public certificate (*.key), so nobody could connect")
        self.socket = context.socket(zmq.REP)
        self.socket.setsockopt(zmq.LINGER, 0)
        self.socket.bind(_ZAP_ADDRESS)

    def protect(self, socket: zmq.Socket) -> None:
        """Prepare a publishing socket, before it is bound."""
        socket.setsockopt(zmq.CURVE_SERVER, 1)
        socket.setsockopt(zmq.CURVE_PUBLICKEY, self._public)
        socket.setsockopt(zmq.CURVE_SECRETKEY, self._secret)
        socket.setsockopt(zmq.ZAP_DOMAIN, _ZAP_DOMAIN)
        socket.setsockopt(zmq.ZAP_ENFORCE_DOMAIN, 1)
        socket.setsockopt(zmq.HEARTBEAT_IVL, 2000)
        socket.setsockopt(zmq.HEARTBEAT_TIMEOUT, 10000)

    def serve(self) -> None:
        """Answer those who knock; the list is read anew for each, so that it can be changed any time."""
        while True:
            try:
                request = self.socket.recv_multipart(zmq.DONTWAIT)
            except zmq.Again:
                return
            version, number, _, address, _, mechanism, *credentials = request
            key = credentials[0] if credentials else b""
            name = self._allowed().get(key) if mechanism == b"CURVE" else None
            if name is None:
                self.denied += 1
                text = z85.encode(key).decode() if len(key) == 32 else "none"
                log.warning("refused %s: its key %s is not in %s", address.decode(), text, self._list)
            verdict = [b"200", b"OK", name.encode()] if name is not None else [b"400", b"unknown key", b""]
            self.socket.send_multipart([version, number, *verdict, b""])

    def _allowed(self) -> dict[bytes, str]:
        """Names of the listed certificates by raw public key; unreadable ones let nobody in."""
        allowed = {}
        for path in sorted(self._list.glob("*.key")):
            try:
                allowed[z85.decode(load_public(path))] = path.stem
            except ValueError as error:
                log.warning("%s", error)
        return allowed
