import contextlib
import socket

import pytest

from corporeal.view.guarded_server import PortError, free_port


def test_a_port_that_is_taken_gives_way_to_the_next():
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        found = free_port(port)
        assert port < found <= port + 100
    assert free_port(port) == port
    assert free_port(0) == 0


@pytest.mark.parametrize("port", [-1, 65536, 10**9])
def test_a_port_that_does_not_exist_is_refused(port):
    with pytest.raises(PortError, match=f"--port {port}: expected a number from 0 to 65535"):
        free_port(port)


def test_the_last_port_is_followed_by_none():
    with socket.socket() as taken:
        # Where another program holds it, it is taken as well.
        with contextlib.suppress(OSError):
            taken.bind(("127.0.0.1", 65535))
            taken.listen()
        with pytest.raises(PortError, match="cannot be listened on"):
            free_port(65535)
