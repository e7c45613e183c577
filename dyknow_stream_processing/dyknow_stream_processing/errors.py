"""Errors of streams."""

from dyknow_common import DyKnowError


class StreamError(DyKnowError):
    """A stream that cannot be made, found or kept."""
