"""The checks that the modules of this folder hold for what is installed."""

from __future__ import annotations

import os
import re
import sys
from collections.abc import Mapping
from contextlib import suppress
from ctypes import c_void_p, sizeof
from pathlib import Path
from typing import Final

from ament_index_python.packages import get_package_share_directory

SWITCH: Final = 'DYKNOW_BELOW_RCLPY'

_VERSION: Final = re.compile(r'<version>\s*([0-9]+\.[0-9]+)\.[0-9]+\s*</version>')
_BYTES_OF_POINTERS: Final = 8


def is_on() -> bool:
    """Return False if the environment turns the modules of this folder off."""
    return os.environ.get(SWITCH) != 'off'


def has_versions(expected: Mapping[str, str]) -> bool:
    """Return True if ROS packages have versions.

    Args:
        expected: major and minor version by package, such as `{'rmw': '7.3'}`. A patch of a
            released distribution changes no structure.
    """
    return all(_version(package) == version for package, version in expected.items())


def has_glibc() -> bool:
    """Return True for the GNU C library with 64-bit pointers."""
    if sys.platform != 'linux' or sizeof(c_void_p) != _BYTES_OF_POINTERS:
        return False
    with suppress(ValueError, OSError):
        return (os.confstr('CS_GNU_LIBC_VERSION') or '').startswith('glibc')
    return False


def _version(package: str) -> str:
    try:
        text = Path(get_package_share_directory(package), 'package.xml').read_text('utf-8')
    except (LookupError, OSError, ValueError):
        return ''
    found = _VERSION.search(text)
    return found[1] if found else ''
