"""The errors of configurations."""

from __future__ import annotations

from dyknow_common import DyKnowError


class ConfigurationError(DyKnowError):
    """A configuration that cannot be read; the message shows the place in its file."""
