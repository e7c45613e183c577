"""Errors of streams."""

from dyknow_common import DyKnowError


class StreamError(DyKnowError):
    """A stream cannot be created, found or kept."""
