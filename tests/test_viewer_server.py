"""The page's server: what goes wrong when it starts, and that it is gone when it stops."""

import socket
import sys
import urllib.error
import urllib.request

import pytest

from inhand.errors import InputError
from inhand.viewer.server import address, serving, start_server, stop_server

viser = pytest.importorskip("viser")


def test_the_page_is_there_until_the_server_stops() -> None:
    with serving("test", port=0) as server:
        where = address(server)
        assert urllib.request.urlopen(where, timeout=10).status == 200
    with pytest.raises(urllib.error.URLError):
        urllib.request.urlopen(where, timeout=10)


def test_a_stopped_server_frees_its_port() -> None:
    server = start_server("test", port=0)
    port = server.get_port()
    stop_server(server)
    with serving("test", port=port) as again:
        assert again.get_port() == port


def test_nothing_is_printed(capfd: pytest.CaptureFixture[str]) -> None:
    with serving("test", port=0):
        pass
    assert capfd.readouterr().out == ""


def test_a_taken_port_is_named_with_the_fix() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = other.getsockname()[1]
        with pytest.raises(InputError, match=rf"port {port} is taken.*--port {port + 1}"):
            start_server("test", port=port)


def test_a_port_taken_in_the_meantime_is_not_silently_another(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("inhand.viewer.server._check_free", lambda host, port: None)
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        with pytest.raises(InputError, match="is taken"):
            start_server("test", port=other.getsockname()[1])


@pytest.mark.parametrize("port", [-1, 65536])
def test_ports_have_bounds(port: int) -> None:
    with pytest.raises(InputError, match=f"no port {port}"):
        start_server("test", port=port)


@pytest.mark.parametrize("host", ["no-such-host.invalid", "203.0.113.7"])
def test_the_host_must_be_this_machine(host: str) -> None:
    with pytest.raises(InputError, match=host):
        start_server("test", host=host, port=0)


def test_a_missing_library_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(InputError, match=r"inhand\[viewer\]"):
        start_server("test", port=0)
