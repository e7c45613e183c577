"""The verb `version`: print the versions of DyKnow and of what it runs on."""

from __future__ import annotations

import argparse
import os
import platform
from importlib.metadata import PackageNotFoundError, version

from dyknow_common.executables import SUCCESS, describe


def version_text() -> str:
    """Return the version of DyKnow, of Python, and of ROS where there is one."""
    ros = os.environ.get('ROS_DISTRO', '')
    return f'dyknow {_own_version()} (Python {platform.python_version()}{ros and f", ROS 2 {ros}"})'


def _own_version() -> str:
    # The wheel without ROS, or the package of the workspace.
    for distribution in ('dyknow', 'dyknow_command'):
        try:
            return version(distribution)
        except PackageNotFoundError:
            continue
    return 'of a source folder'


def print_version(_: argparse.Namespace) -> int:
    """Print the version; return the exit code."""
    print(version_text())  # noqa: T201 - this is a command
    return SUCCESS


def add_version_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the verb."""
    parser.set_defaults(command=print_version)
    describe(parser, 'Print the version.', ('dyknow version',), '0')
