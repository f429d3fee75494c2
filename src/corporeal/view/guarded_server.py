"""viser's server as our pages use it: on this machine only, behind the token, on a port that is free."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Iterator, Mapping

import rich
import viser

from corporeal.view.guard import Route, TokenGuard, guarding

HOST = "127.0.0.1"
_TRIES = 100


class PortError(ValueError):
    """No port can be listened on; the message says what to do."""


class GuardedServer:
    """A viser server that answers nobody without the token of this run.

    Attributes:
        viser: the server, for scene and panel.
        port: that it listens on.
        url: the address with its token.
    """

    def __init__(self, label: str, routes: Mapping[str, Route], port: int = 0) -> None:
        """Start to serve.

        Args:
            label: title of the page.
            routes: path -> who answers it; every other path is viser's.
            port: to listen on; 0 for any. If it is taken, the next free one.

        Raises:
            PortError: there is no such port, or none of the next hundred is free.
        """
        guard = TokenGuard(routes)
        with guarding(guard), _without_banner():
            self.viser = viser.ViserServer(host=HOST, port=free_port(port), label=label, verbose=False)
        # The share button would open a way past this machine and the token.
        self.viser.gui.configure_theme(
            control_width="large", dark_mode=False, show_logo=False, show_share_button=False
        )
        self.port = self.viser.get_port()
        self.url = f"http://{HOST}:{self.port}/?token={guard.token}"

    def stop(self) -> None:
        """Stop serving."""
        with _without_banner():
            self.viser.stop()


def free_port(port: int) -> int:
    """The first port from this one on that can be listened on; 0, any, stays 0.

    viser itself would wait for ever for a port beyond the last, and tries a thousand others for one that
    this user may not have.

    Raises:
        PortError: there is no such port, or none of the next hundred is free.
    """
    if not 0 <= port <= 65535:
        raise PortError(f"--port {port}: expected a number from 0 to 65535; 0 takes any that is free")
    if port == 0:
        return 0
    trouble = ""
    for candidate in range(port, min(port + _TRIES, 65536)):
        with socket.socket(socket.AF_INET, socket.SOCK_STREAM) as tried:
            # As asyncio does: a page that has just ended does not keep its port.
            tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            try:
                tried.bind((HOST, candidate))
                return candidate
            except OSError as error:
                trouble = trouble or str(error.strerror or error)
    raise PortError(
        f"--port {port}: cannot be listened on ({trouble}), nor can those after it; name another, or 0 for "
        "any that is free"
    )


@contextlib.contextmanager
def _without_banner() -> Iterator[None]:
    """viser prints an address without the token, which is refused; ours is printed by the command."""
    console = rich.get_console()
    quiet, console.quiet = console.quiet, True
    try:
        yield
    finally:
        console.quiet = quiet
