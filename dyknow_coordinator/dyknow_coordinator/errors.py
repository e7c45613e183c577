"""Errors of the coordinator."""

from dyknow_common import DyKnowError


class CoordinationError(DyKnowError):
    """A formula cannot be grounded, or its evaluation ended without a verdict."""
