"""What can go wrong in answering a formula."""

from dyknow_stream_processing import DyKnowError


class CoordinationError(DyKnowError):
    """A formula that cannot be grounded, or whose evaluation ended without a verdict."""
