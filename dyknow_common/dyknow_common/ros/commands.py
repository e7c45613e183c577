"""What commands share that ask running nodes: their life, a node that waits, durations."""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Callable, Sequence

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from dyknow_common.durations import parse_duration
from dyknow_common.errors import DyKnowError

TICK = 0.1
"""Seconds between two looks whether a wait is over."""

INTERRUPTED = 130
"""The exit code of a command that the user has interrupted."""


class CommandNode:
    """A node that is there for as long as a command runs, and whose waits end.

    Args:
        command: its name, by which the node is known.
    """

    def __init__(self, command: str) -> None:
        self.node = Node(f'{command}_{os.getpid()}', start_parameter_services=False)
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def close(self) -> None:
        """Leaves the ROS graph."""
        self._executor.shutdown()
        self.node.destroy_node()

    def end_of_wait(self, timeout: int) -> int:
        """When a wait is over that begins now and lasts so many nanoseconds."""
        return self._clock.now().nanoseconds + timeout

    def spin_until(
        self, condition: Callable[[], bool], end: int, silence: Callable[[], DyKnowError]
    ) -> None:
        """Runs callbacks until a condition holds.

        Args:
            condition: what is waited for.
            end: when the wait is over, by `end_of_wait`.
            silence: the error to raise then.
        """
        while not condition():
            if self._clock.now().nanoseconds > end:
                raise silence()
            self._executor.spin_once(timeout_sec=TICK)


def run_command(
    name: str,
    options: Callable[[Sequence[str]], argparse.Namespace],
    work: Callable[[argparse.Namespace, CommandNode], None],
    exit_code: Callable[[DyKnowError], int],
) -> int:
    """Runs a command with a node of its own; the main function of its executable.

    Args:
        name: of the command, for its node and its complaints.
        options: makes sense of the arguments on the command line.
        work: what is to be done with them.
        exit_code: what an error that ends the work means to the caller.

    Returns:
        The exit code: 0 when the work is done, 130 when it is interrupted.
    """
    chosen = options(remove_ros_args(sys.argv)[1:])
    # An interrupt is to end the command by an exception, with a context that is still whole.
    rclpy.init(args=sys.argv, signal_handler_options=SignalHandlerOptions.NO)
    node = CommandNode(name)
    try:
        work(chosen, node)
    except DyKnowError as error:
        print(f'{name}: {error}', file=sys.stderr)  # noqa: T201 - this is a command
        return exit_code(error)
    except KeyboardInterrupt:
        return INTERRUPTED
    finally:
        node.close()
        rclpy.try_shutdown()
    return 0


def duration(text: str) -> int:
    """A duration on the command line, nanoseconds; a type for argparse.

    Raises:
        ArgumentTypeError: when it is none.
    """
    try:
        return parse_duration(text)
    except ValueError as error:
        raise argparse.ArgumentTypeError(str(error)) from None
