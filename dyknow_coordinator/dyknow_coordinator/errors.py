"""What can go wrong in answering a formula."""

from dyknow_common import DyKnowError


class CoordinationError(DyKnowError):
    """A formula that cannot be grounded, or whose evaluation ended without a verdict."""
