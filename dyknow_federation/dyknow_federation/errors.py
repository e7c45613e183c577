"""The errors of the federation."""

from __future__ import annotations

from dyknow_common import DyKnowError


class FederationError(DyKnowError):
    """An error of this package, as a message of a peer that breaks the protocol."""


class VersionError(FederationError):
    """A message of a peer that speaks another version of the protocol.

    Args:
        sender: the name of the peer.
        version: its version.
        message: names both versions and the remedy.
    """

    def __init__(self, sender: str, version: int, message: str) -> None:
        super().__init__(message)
        self.sender = sender
        self.version = version
