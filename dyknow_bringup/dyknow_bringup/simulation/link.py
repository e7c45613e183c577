"""A link between two hosts that can fail: a relay between their TCP connections."""

from __future__ import annotations

import socket
from contextlib import suppress
from itertools import chain
from threading import Thread
from typing import Final, Self

HERE: Final = '127.0.0.1'
_BYTES: Final = 65_536


def free_port() -> int:
    """Return a TCP port of this computer that nobody listens on."""
    with socket.create_server((HERE, 0)) as found:
        return int(found.getsockname()[1])


class FailingLink:
    """A link to a port of this computer, which lets everything pass until it is cut.

    Args:
        target: the port to which it leads.

    Attributes:
        port: the port at which it begins.
    """

    def __init__(self, target: int) -> None:
        self._target = target
        self._pairs: list[tuple[socket.socket, socket.socket]] = []
        self._is_cut = False
        self._server = socket.create_server((HERE, 0))
        self.port = int(self._server.getsockname()[1])
        Thread(target=self._accept, daemon=True).start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def cut(self) -> None:
        """End all connections, and refuse others."""
        self._is_cut = True
        for each in chain.from_iterable(self._pairs):
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def restore(self) -> None:
        """Accept connections again."""
        self._is_cut = False

    def close(self) -> None:
        """End the link."""
        self.cut()
        self._server.close()

    def _accept(self) -> None:
        with suppress(OSError):
            while True:
                near, _ = self._server.accept()
                if self._is_cut or not self._join(near):
                    near.close()

    def _join(self, near: socket.socket) -> bool:
        """Connect an accepted connection to the target; return False if nobody listens there."""
        try:
            far = socket.create_connection((HERE, self._target))
        except ConnectionRefusedError:  # The host has not started yet.
            return False
        self._pairs.append((near, far))
        Thread(target=_relay, args=(near, far), daemon=True).start()
        return True


def _relay(near: socket.socket, far: socket.socket) -> None:
    """Pass on what comes from each end to the other one, and close both at the end."""
    with near, far:
        back = Thread(target=_pass_on, args=(far, near), daemon=True)
        back.start()
        _pass_on(near, far)
        back.join()


def _pass_on(source: socket.socket, goal: socket.socket) -> None:
    with suppress(OSError):
        while data := source.recv(_BYTES):
            goal.sendall(data)
    for each in (source, goal):
        with suppress(OSError):
            each.shutdown(socket.SHUT_RDWR)
