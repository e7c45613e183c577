"""The library of geometry, which only regions and neighbours need."""

from __future__ import annotations

from functools import cache
from importlib import import_module
from typing import Any

from dyknow_common import ExitCode
from dyknow_space.errors import SpaceError


@cache
def shapely() -> Any:
    """Return the module shapely.

    Raises:
        SpaceError: naming the mend, if it is not installed.
    """
    try:
        return import_module('shapely')
    except ImportError as error:
        raise SpaceError(
            f'regions and neighbours need shapely: {error}; run: pip install shapely',
            ExitCode.UNAVAILABLE,
        ) from None
