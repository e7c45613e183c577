"""Exit codes of commands."""

from __future__ import annotations

import sys
from collections.abc import Callable

from rclpy.executors import ExternalShutdownException

from dyknow_common import DyKnowError
from dyknow_common.ros import INTERRUPTED


def exit_code(command: str, work: Callable[[], int], on_error: int) -> int:
    """Return the exit code of a command.

    Args:
        command: its name, for error messages.
        work: does the work and returns the exit code.
        on_error: the exit code after a DyKnowError.
    """
    try:
        return work()
    except DyKnowError as error:
        print(f'{command}: {error}', file=sys.stderr)  # noqa: T201 - this is a command
        return on_error
    except (KeyboardInterrupt, ExternalShutdownException):
        return INTERRUPTED
