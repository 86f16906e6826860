"""The web server of a page: started on a port that is free, stopped without a trace."""

import errno
import io
import socket
from collections.abc import Iterator
from contextlib import contextmanager, redirect_stdout
from typing import Any

from inhand.errors import InputError

HOST = "127.0.0.1"
"""Only this machine sees the page; over SSH, forward the port."""
PORT = 8080


@contextmanager
def serving(title: str, *, host: str = HOST, port: int = PORT) -> Iterator[Any]:
    """A `viser.ViserServer` that is stopped at the end.

    Args:
        title: label of the page's control panel.
        host: address that it listens on; "0.0.0.0" lets other machines in.
        port: port that it listens on, 0 for any that is free.

    Raises:
        InputError: as `start_server`.
    """
    server = start_server(title, host=host, port=port)
    try:
        yield server
    finally:
        stop_server(server)


def start_server(title: str, *, host: str = HOST, port: int = PORT) -> Any:
    """Start a `viser.ViserServer`; `serving` says what the arguments are.

    Raises:
        InputError: viser is not installed, the port is taken or not allowed, or the host is not an
            address of this machine.
    """
    try:
        import viser
    except ImportError as error:
        raise InputError(
            f"the viewer's libraries are not installed ({error}): pip install 'inhand[viewer]'"
        ) from error
    _check_free(host, port)
    with redirect_stdout(io.StringIO()):  # it would print a banner
        server = viser.ViserServer(host=host, port=port, label=title, verbose=False)
    if port not in (0, server.get_port()):  # taken since: viser went on to the next one
        stop_server(server)
        raise InputError(_taken(port))
    server.gui.configure_theme(dark_mode=True, show_logo=False, show_share_button=False)
    return server


def stop_server(server: Any) -> None:
    """Stop a server; browsers that show its page say that they lost it."""
    with redirect_stdout(io.StringIO()):
        server.stop()


def address(server: Any) -> str:
    """What to type into a browser."""
    host = server.get_host()
    return f"http://{'localhost' if host in (HOST, '0.0.0.0') else host}:{server.get_port()}"


def _check_free(host: str, port: int) -> None:
    """Raise InputError when nothing can listen on that port."""
    if not 0 <= port <= 65535:
        raise InputError(f"there is no port {port}: expected a number from 1 to 65535")
    try:
        family, kind, protocol, _, where = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[
            0
        ]
        with socket.socket(family, kind, protocol) as probe:
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            probe.bind(where)
            probe.listen()
    except PermissionError as error:
        raise InputError(f"port {port} is not allowed: choose one above 1023") from error
    except socket.gaierror as error:
        raise InputError(f'"{host}" is no address of this machine ({error.strerror})') from error
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            raise InputError(_taken(port)) from error
        raise InputError(f'cannot listen on "{host}", port {port}: {error.strerror}') from error


def _taken(port: int) -> str:
    return (
        f"port {port} is taken, perhaps by another viewer: stop that, or choose another port "
        f"(--port {port + 1 if port < 65535 else PORT})"
    )
