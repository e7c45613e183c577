"""Errors of this package."""

from dyknow_common import DyKnowError


class DashboardError(DyKnowError):
    """A request of a page that cannot be met."""
