"""The errors of recordings."""

from __future__ import annotations

from dyknow_common import DyKnowError


class RecordingError(DyKnowError):
    """A recording that cannot be read, or not be evaluated."""
