"""The errors of space."""

from __future__ import annotations

from dyknow_common import DyKnowError


class SpaceError(DyKnowError):
    """A region that cannot be used, or positions that cannot be compared."""
