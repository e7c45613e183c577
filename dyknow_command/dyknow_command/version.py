"""The verb `version`: print the versions of DyKnow and of what it runs on."""

from __future__ import annotations

import argparse
import os
import platform

from dyknow_common.executables import SUCCESS, describe, installed_version


def print_version(_: argparse.Namespace) -> int:
    """Print the version of DyKnow, of Python, and of ROS where there is one."""
    ros = os.environ.get('ROS_DISTRO', '')
    own, python = installed_version(), platform.python_version()
    print(f'dyknow {own} (Python {python}{ros and f", ROS 2 {ros}"})')  # noqa: T201 - a command
    return SUCCESS


def add_version_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the verb."""
    parser.set_defaults(command=print_version)
    describe(parser, 'Print the version.', ('dyknow version',), '0')
