"""The errors of reactions."""

from dyknow_common import DyKnowError


class ReactionError(DyKnowError):
    """A reaction that cannot be set up."""
