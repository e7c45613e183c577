"""Errors in the evaluation of formulas."""

from __future__ import annotations

from dyknow_common import DyKnowError


class ReasoningError(DyKnowError):
    """A formula that cannot be evaluated, or a state that it cannot be evaluated over."""
