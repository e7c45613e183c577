"""A link that fails: connections end, others are refused, and later ones pass again."""

from __future__ import annotations

import socket

from dyknow_bringup.simulation.link import HERE, FailingLink

TIMEOUT_S = 30.0


def connected(port: int) -> socket.socket:
    return socket.create_connection((HERE, port), TIMEOUT_S)


def test_nothing_passes_a_link_that_is_cut() -> None:
    with socket.create_server((HERE, 0)) as server, FailingLink(server.getsockname()[1]) as link:
        server.settimeout(TIMEOUT_S)
        with connected(link.port) as near:
            far, _ = server.accept()
            near.sendall(b'there')
            assert far.recv(10) == b'there'
            far.sendall(b'back')
            assert near.recv(10) == b'back'
            link.cut()
            assert (near.recv(10), far.recv(10)) == (b'', b'')
            far.close()
        with connected(link.port) as refused:
            assert refused.recv(10) == b''
        link.restore()
        with connected(link.port) as near:
            far, _ = server.accept()
            far.sendall(b'again')
            assert near.recv(10) == b'again'
            far.close()


def test_a_link_to_a_host_that_has_not_started() -> None:
    # No other process can take a port that is bound.
    with socket.socket() as host:
        host.bind((HERE, 0))
        with FailingLink(host.getsockname()[1]) as link, connected(link.port) as near:
            assert near.recv(10) == b''
