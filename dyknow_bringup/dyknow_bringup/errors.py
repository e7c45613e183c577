"""Errors in the data of the demonstration."""

from __future__ import annotations

from dyknow_common import DyKnowError


class BringupError(DyKnowError):
    """An unusable scenario, formula file, fleet, recording or process."""
