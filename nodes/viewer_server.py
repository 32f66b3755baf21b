"""A viser server that only those may reach who should: loopback unless asked for, then behind a token."""

import contextlib
import io
import logging

from ..messages.config import ConfigError
from .viewer_gate import Gate
from .viewer_light import light

LOOPBACK = ("127.0.0.1", "::1", "localhost")


class Window:
    """A viser server and the gate before it.

    Args:
        host: Address to listen at; anything but loopback needs a token.
        port: TCP port; 0 takes a free one.
        title: What stands over the controls.
        token: What a browser must know; None for loopback only.

    Raises:
        ConfigError: viser is not installed, the port is taken, or the address is open and has no token.
    """

    def __init__(self, host: str, port: int, title: str, token: str | None = None) -> None:
        if host not in LOOPBACK and not token:
            raise ConfigError(f"viewer: {host} can be reached from elsewhere; that needs a token")
        try:
            import viser
        except ImportError:
            raise ConfigError("viewer: viser is missing; `pip install 'footfall[view]'`") from None
        logging.getLogger("websockets").setLevel(logging.WARNING)
        with contextlib.redirect_stdout(io.StringIO()):
            self.server = viser.ViserServer("127.0.0.1", 0, title, verbose=False)
        try:
            self.gate = Gate(host, port, self.server.get_port(), token)
        except OSError as error:
            self.server.stop()
            raise ConfigError(f"viewer: cannot listen at {host}:{port}: {error.strerror}") from None
        self.server.gui.configure_theme(
            show_logo=False, show_share_button=False, control_width="large", brand_color=(38, 92, 140)
        )
        light(self.server)

    @property
    def url(self) -> str:
        """What to open in a browser."""
        return self.gate.url

    def close(self) -> None:
        """Stop serving."""
        self.gate.close()
        with contextlib.redirect_stdout(io.StringIO()):
            self.server.stop()
