"""The start of ROS, and commands that ask running nodes: their main function, their node."""

from __future__ import annotations

import argparse
import os
import re
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import closing, contextmanager
from functools import partial
from itertools import pairwise
from typing import Any, Final

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import NameValidationException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.signals import SignalHandlerOptions
from rclpy.utilities import remove_ros_args

from dyknow_common.durations import SECOND_NS
from dyknow_common.errors import DyKnowError, ExitCode, one_line
from dyknow_common.executables import SUCCESS, interruptible, run_main
from dyknow_common.ros.below_rclpy.discovery import announce_in_thread
from dyknow_common.ros.node import snake_case
from dyknow_common.ros.qos import SERVICE
from dyknow_common.ros.time_messages import error_from_message
from dyknow_common.ros.topic_names import RCLError

TICK_PERIOD_S = 0.1
"""The period in which a waiting command checks its deadline."""

_LAST_DOMAIN: Final = 232
"""The greatest domain whose ports exist (DDSI-RTPS 2.2, section 9.6.1.3)."""

_PARAMETER_FLAGS: Final = {'-p', '--param'}
_NAMES_IN_ROS: Final = {'namespace': '__ns'}
"""Options of commands whose name differs from what --ros-args sets."""

ROS_ERRORS = (
    NameValidationException,
    RCLError,
    rclpy_implementation.UnknownROSArgsError,
)
"""Errors of rclpy about what the user has written on the command line."""


def start_ros(arguments: Sequence[str] | None = None) -> None:
    """Initialise rclpy without its signal handlers.

    Args:
        arguments: the arguments of the command line; None: the arguments of this process.

    Raises:
        RCLError: and other errors of `rclpy.init`; also for a domain that DDS does not have.
    """
    announce_in_thread()
    arguments = None if arguments is None else list(arguments)
    rclpy.init(args=arguments, signal_handler_options=SignalHandlerOptions.NO)
    # With the first node, Fast DDS would end the process with an exit code of its own.
    if (domain := rclpy.get_default_context().get_domain_id()) > _LAST_DOMAIN:
        rclpy.try_shutdown()
        raise RCLError(f'ROS_DOMAIN_ID is {domain}; use 0 to {_LAST_DOMAIN}')


class CommandNode:
    """The node of a command, which exists while the command runs.

    Args:
        command: the name of the command; the node's name begins with it.
    """

    def __init__(self, command: str) -> None:
        self.node = Node(f'{command}_{os.getpid()}', start_parameter_services=False)
        self._clock = Clock(clock_type=ClockType.STEADY_TIME)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self.node)

    def close(self) -> None:
        """Leave the ROS graph."""
        self._executor.shutdown()
        self.node.destroy_node()

    def deadline(self, timeout_ns: int) -> int:
        """Return the time of the node's clock after a timeout, in nanoseconds."""
        return self._clock.now().nanoseconds + timeout_ns

    def spin_until(
        self, condition: Callable[[], bool], deadline: int, error: Callable[[], DyKnowError]
    ) -> None:
        """Run callbacks until a condition holds.

        Args:
            condition: the condition.
            deadline: the end of the wait, from `deadline`.
            error: makes the error that is raised after the deadline.
        """
        while not condition():
            if self._clock.now().nanoseconds > deadline:
                raise error()
            self._executor.spin_once(timeout_sec=TICK_PERIOD_S)

    def spin_for(self, duration: int) -> None:
        """Run callbacks for a time, in nanoseconds."""
        end = self.deadline(duration)
        while (left := end - self._clock.now().nanoseconds) > 0:
            self._executor.spin_once(timeout_sec=min(left / SECOND_NS, TICK_PERIOD_S))

    def call(self, service_type: Any, node: str, timeout_ns: int, **fields: Any) -> Any:
        """Return the response of a node's service.

        Args:
            service_type: the type of the service; it determines the name of the service.
            node: its name, relative to the namespace of the command or absolute.
            timeout_ns: the time to wait for the response.
            fields: the fields of the request.

        Raises:
            DyKnowError: UNAVAILABLE, if there is no response in time; the error of a refusal.
        """
        client = self.node.create_client(
            service_type, f'{node}/{snake_case(service_type.__name__)}', qos_profile=SERVICE
        )
        no_response = partial(self._no_response, node, timeout_ns)
        end = self.deadline(timeout_ns)
        self.spin_until(client.service_is_ready, end, no_response)
        future = client.call_async(service_type.Request(**fields))
        self.spin_until(future.done, end, no_response)
        response = future.result()
        if error := error_from_message(response.exit_status):
            raise error
        return response

    def _no_response(self, node: str, timeout_ns: int) -> DyKnowError:
        return DyKnowError(
            f'{self.node.resolve_service_name(node)} has not answered within '
            f'{timeout_ns / SECOND_NS:g} s; is DyKnow running, in this namespace and ROS domain?',
            ExitCode.UNAVAILABLE,
        )


def command_main(name: str, add_options: Callable[[argparse.ArgumentParser], None]) -> int:
    """Run an executable that is one command, and return its exit code.

    Args:
        name: the name of the command, for its help and its error messages.
        add_options: adds the options, among them `command`, which does the work.
    """

    def run() -> int:
        parser = argparse.ArgumentParser(prog=name)
        add_options(parser)
        return run_chosen(parser.parse_args(remove_ros_args(sys.argv)[1:]), sys.argv)

    return run_ros_main(name, run)


def run_chosen(chosen: argparse.Namespace, arguments: Sequence[str]) -> int:
    """Run a command with its options, and return its exit code.

    A command passes the arguments of --ros-args to its node, or states what to use in their place
    as the default of `instead_of_ros_arguments`. None is ignored.

    Args:
        chosen: the options, among them `command`, which does the work.
        arguments: the command line, with the arguments of --ros-args.

    Raises:
        DyKnowError: for arguments of --ros-args that have no effect.
    """
    given = list(_ros_arguments(arguments))
    if given and (instead := getattr(chosen, 'instead_of_ros_arguments', '')):
        raise DyKnowError(f'"--ros-args {" ".join(given)}" would have no effect: {instead}')
    settings = [
        each for flag, each in pairwise(given) if flag in _PARAMETER_FLAGS or '__ns:=' in each
    ]
    for option, value in vars(chosen).items():
        name = _NAMES_IN_ROS.get(option, option)
        if value and any(re.search(f'(^|:){name}:=', each) for each in settings):
            raise DyKnowError(
                f'--ros-args sets {name}, and so does the option or argument {option} of this '
                'command; use one of them'
            )
    return int(chosen.command(chosen))


def _ros_arguments(arguments: Iterable[str]) -> Iterator[str]:
    """Yield the arguments between --ros-args and --, as rcl finds them."""
    is_of_ros = False
    for each in arguments:
        if each == '--ros-args' or (is_of_ros and each == '--'):
            is_of_ros = each == '--ros-args'
        elif is_of_ros:
            yield each


def run_with_node(name: str, work: Callable[[CommandNode], None]) -> int:
    """Do the work of a command with a node of its own, and return the exit code.

    Args:
        name: the name of the command, for its node.
        work: does the work of the command.
    """
    # An interrupt must end the command by an exception, while its context is still valid.
    start_ros()
    try:
        with closing(CommandNode(name)) as node, interruptible():
            work(node)
    finally:
        rclpy.try_shutdown()
    return SUCCESS


def run_ros_main(command: str, work: Callable[[], int]) -> int:
    """Do the work of a command that uses ROS; arguments and result as in `run_main`."""

    def work_of_command() -> int:
        with ros_errors():
            return work()

    return run_main(command, work_of_command)


@contextmanager
def ros_errors() -> Iterator[None]:
    """Raise errors of ROS in a block as what `run_main` expects."""
    try:
        yield
    except ExternalShutdownException:
        raise KeyboardInterrupt from None
    except ROS_ERRORS as error:
        raise DyKnowError(one_line(error)) from None
