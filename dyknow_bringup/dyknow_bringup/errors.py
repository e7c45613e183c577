"""What can go wrong with the data of the demonstration."""

from __future__ import annotations

from dyknow_common import DyKnowError


class BringupError(DyKnowError):
    """A scenario, a formula file, a fleet or a recording that cannot be used."""
