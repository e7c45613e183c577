"""The errors of the federation."""

from __future__ import annotations

from dyknow_common import DyKnowError


class FederationError(DyKnowError):
    """An error of this package, as a message of a peer that breaks the protocol."""
