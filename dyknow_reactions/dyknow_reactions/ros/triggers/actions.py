"""The actions of triggers: messages, calls and goals for other nodes, and commands."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import tempfile
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from typing import Any, Final, Protocol

from action_msgs.msg import GoalStatus, GoalStatusArray
from action_msgs.srv import CancelGoal
from rclpy.action import ActionClient
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.qos import QoSProfile, ReliabilityPolicy, qos_profile_action_status_default
from rclpy.task import Future

from dyknow_common import DyKnowError, shortened
from dyknow_common.ros import NodeAdapter, RCLError
from dyknow_configuration import Trigger, TriggerKind, filled
from dyknow_reactions.ros.triggers.message_template import template_of
from dyknow_reactions.ros.triggers.targets import target_fault, target_of
from dyknow_reactions.triggers import TriggerReport

POLL_PERIOD_S: Final = 0.05
"""The period of checks for a server that has not been discovered, and of looks at a command."""

_QUALITY_OF_SERVICE: Final = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)

End = Callable[[str], None]
"""Ends an attempt, once: with the reason of its failure, or an empty text."""

GiveUp = Callable[[], str]
"""Gives up an attempt whose time has passed, and returns the text to report."""

SHOWN: Final = 300
"""The number of bytes of the error output of a command that a message shows, from the end."""

MAX_ERRORS: Final = 1_000_000
"""The number of bytes of the error output of a command that are kept in a file."""

STATUS_DELAY_S: Final = 0.2
"""The time from the response to a cancellation to the status of the goals after it."""

_RUNNING: Final = (GoalStatus.STATUS_ACCEPTED, GoalStatus.STATUS_EXECUTING)
"""The states of goals that have not been asked to end."""

KILL_TIMEOUT_S: Final = 1.0
"""The time in which a killed process ends, unless a device blocks it."""


class TriggerAction(Protocol):
    """The action of a trigger."""

    def begin(self, report: TriggerReport, end: End) -> GiveUp:
        """Begin an attempt, without waiting for it.

        Raises:
            DyKnowError: if it has failed already.
        """

    def close(self) -> None:
        """Release everything; no attempt is running."""


class PublishAction:
    """Publishes a message."""

    def __init__(self, node: NodeAdapter, trigger: Trigger) -> None:
        self._node, self._trigger = node.node, trigger
        class_, self._template = template_of(trigger)
        self._topic = target_of(node.node, trigger)
        # Clients and publishers apply the remappings of the node by themselves.
        self._publisher = node.node.create_publisher(class_, trigger.target, _QUALITY_OF_SERVICE)

    def begin(self, report: TriggerReport, end: End) -> GiveUp:
        """Publish the message, if there is a subscriber."""
        message = self._template.fill(report)
        if self._publisher.get_subscription_count() == 0:
            raise DyKnowError(self._lack())
        self._publisher.publish(message)
        end('')
        return lambda: ''

    def close(self) -> None:
        """Destroy the publisher."""
        self._node.destroy_publisher(self._publisher)

    def _lack(self) -> str:
        """Return why no subscriber receives the messages."""
        if fault := target_fault(self._node, self._trigger):
            return fault.text
        return (
            f'no subscriber of {self._topic} requests a quality of service that triggers offer: '
            'reliable, volatile, without deadlines'
        )


class CallAction:
    """Calls a service; a response with `success: false` is a failure."""

    def __init__(self, node: NodeAdapter, trigger: Trigger) -> None:
        class_, self._template = template_of(trigger)
        self._node, self._trigger = node, trigger
        self._name = target_of(node.node, trigger)
        self._client = node.create_client(
            class_, trigger.target, callback_group=ReentrantCallbackGroup()
        )

    def begin(self, report: TriggerReport, end: End) -> GiveUp:
        """Send the request as soon as the service is there."""
        request = self._template.fill(report)
        return _RemoteCall(
            self._node,
            self._trigger,
            f'service {self._name}',
            self._client.service_is_ready,
            lambda: self._client.call_async(request),
            _failure_of_response,
            end,
            self._client.remove_pending_request,
        ).give_up

    def close(self) -> None:
        """Destroy the client."""
        self._node.destroy_client(self._client)


class SendGoalAction:
    """Sends a goal to an action; it is done when the goal is accepted."""

    def __init__(self, node: NodeAdapter, trigger: Trigger) -> None:
        class_, self._template = template_of(trigger)
        self._node, self._trigger = node, trigger
        self._name = target_of(node.node, trigger)
        self._client = ActionClient(
            node.node, class_, self._name, callback_group=ReentrantCallbackGroup()
        )

    def begin(self, report: TriggerReport, end: End) -> GiveUp:
        """Send the goal as soon as the action is there."""
        goal = self._template.fill(report)
        return _RemoteCall(
            self._node,
            self._trigger,
            f'action {self._name}',
            self._client.server_is_ready,
            lambda: self._client.send_goal_async(goal),
            lambda handle: '' if handle.accepted else f'action {self._name} rejects the goal',
            end,
            # The failure was reported, and another goal may follow.
            lambda sent: sent.add_done_callback(_cancel_goal),
        ).give_up

    def close(self) -> None:
        """Destroy the client."""
        self._client.destroy()


class CancelGoalAction:
    """Cancels all goals of an action, of all clients.

    A server of rclpy that refuses answers as one without goals does. The status of the action tells
    that goals still run.
    """

    def __init__(self, node: NodeAdapter, trigger: Trigger) -> None:
        self._node, self._trigger = node, trigger
        self._name = target_of(node.node, trigger)
        self._running: frozenset[bytes] = frozenset()
        self._statuses: Any = None
        with suppress(RCLError):  # A policy may not permit it.
            self._statuses = node.node.create_subscription(
                GoalStatusArray,
                f'{self._name}/_action/status',
                self._note_statuses,
                qos_profile_action_status_default,
                callback_group=ReentrantCallbackGroup(),
            )
        self._client = node.create_client(
            CancelGoal,
            f'{self._name}/_action/cancel_goal',
            callback_group=ReentrantCallbackGroup(),
        )

    def begin(self, report: TriggerReport, end: End) -> GiveUp:  # noqa: ARG002 - of the protocol
        """Request that all goals are cancelled as soon as the action is there."""
        refusal = f'action {self._name} refuses to cancel its goals'
        refused: set[bytes] = set()

        def send() -> Future:
            refused.update(self._running)
            # No goal and no time stand for all goals.
            return self._client.call_async(CancelGoal.Request())

        def failure_of(response: Any) -> str:
            refused.update(self._running)
            refused.difference_update(map(_goal_id, response.goals_canceling))
            return refusal if response.return_code == CancelGoal.Response.ERROR_REJECTED else ''

        def end_with_status(failure: str) -> None:
            if failure or not refused:
                end(failure)
                return
            # Goals may have ended meanwhile.
            later = self._node.deadlines.after(STATUS_DELAY_S)
            later.add_done_callback(lambda _: end(refusal if refused & self._running else ''))

        return _RemoteCall(
            self._node,
            self._trigger,
            f'action {self._name}',
            self._client.service_is_ready,
            send,
            failure_of,
            end_with_status,
            self._client.remove_pending_request,
        ).give_up

    def close(self) -> None:
        """Destroy the client and the subscription."""
        self._node.destroy_client(self._client)
        if self._statuses is not None:
            self._node.node.destroy_subscription(self._statuses)

    def _note_statuses(self, message: Any) -> None:
        self._running = frozenset(
            _goal_id(each.goal_info) for each in message.status_list if each.status in _RUNNING
        )


@dataclass(eq=False)
class _RemoteCall:
    """A request to another node, which is sent when the node is there.

    Args:
        node: its deadlines are used.
        trigger: the trigger.
        name: the name of the server, for people.
        is_ready: returns True if the server is there.
        send: sends the request.
        failure_of: returns why a response is a failure; an empty text if it is none.
        end: ends the attempt.
        abandon: receives the future of a response that is not needed any more.
    """

    node: NodeAdapter
    trigger: Trigger
    name: str
    is_ready: Callable[[], bool]
    send: Callable[[], Future]
    failure_of: Callable[[Any], str]
    end: End
    abandon: Callable[[Future], object]

    def __post_init__(self) -> None:
        """Begin."""
        self._sent: Future | None = None
        self._is_over = False
        self._poll()

    def give_up(self) -> str:
        """End without a response, and return the reason."""
        self._is_over = True
        if self._sent is None:
            fault = target_fault(self.node.node, self.trigger)
            reason = f' ({fault.text})' if fault and not fault.is_missing else ''
            return f'{self.name} is not available{reason}'
        self.abandon(self._sent)
        return f'{self.name} has not answered'

    def _poll(self) -> None:
        if self._is_over:
            return
        if self.is_ready():
            self._sent = self.send()
            self._sent.add_done_callback(self._on_response)
        else:
            later = self.node.deadlines.after(POLL_PERIOD_S)
            later.add_done_callback(lambda _: self._poll())

    def _on_response(self, done: Future) -> None:
        if self._is_over or done.cancelled():
            return
        self._is_over = True
        error = done.exception()
        self.end(str(error) if error else self.failure_of(done.result()))


def _goal_id(info: Any) -> bytes:
    return bytes(info.goal_id.uuid)


def _failure_of_response(response: Any) -> str:
    if getattr(response, 'success', True) is not False:
        return ''
    reason = shortened(getattr(response, 'message', ''))
    return f'the service answers success: false{f" ({reason})" if reason else ""}'


def _cancel_goal(sent: Future) -> None:
    if not sent.cancelled() and sent.exception() is None and sent.result().accepted:
        sent.result().cancel_goal_async()


class RunAction:
    """Runs a command as a child process, without a shell.

    Raises:
        ConfigurationError: if there is no such command.
    """

    def __init__(self, node: NodeAdapter, trigger: Trigger) -> None:
        self._node = node
        self._arguments = tuple(trigger.content)
        self._command = command_of(trigger)

    def begin(self, report: TriggerReport, end: End) -> GiveUp:
        """Start the process."""
        line = [self._command, *(filled(each, report.texts) for each in self._arguments)]
        try:
            process = _Process(self._node, line, end)
        except (OSError, ValueError) as error:
            raise DyKnowError(f'{self._command} cannot be run: {error}') from None
        return process.give_up

    def close(self) -> None:
        """Do nothing: there is nothing to release."""


def command_of(trigger: Trigger) -> str:
    """Return the path of the command of a trigger.

    Raises:
        ConfigurationError: if there is none.
    """
    found = shutil.which(trigger.target)
    if found is None:
        text = f"there is no command '{trigger.target}'; install it, or give its path"
        raise trigger.error(text, ('run', 0))
    return found


def check_action(trigger: Trigger) -> None:
    """Check what the action of a trigger needs beside a node: its type, its fields, its command.

    Raises:
        ConfigurationError: if it lacks something.
    """
    if trigger.kind is TriggerKind.RUN:
        command_of(trigger)
    elif trigger.type_name:
        template_of(trigger)


ACTIONS: Final[Mapping[TriggerKind, Callable[[NodeAdapter, Trigger], TriggerAction]]] = {
    TriggerKind.PUBLISH: PublishAction,
    TriggerKind.CALL: CallAction,
    TriggerKind.SEND_GOAL: SendGoalAction,
    TriggerKind.CANCEL_GOAL: CancelGoalAction,
    TriggerKind.RUN: RunAction,
}


class _Process:
    """A child process with its own children, which end with it."""

    def __init__(self, node: NodeAdapter, line: list[str], end: End) -> None:
        self._node = node
        self._end = end
        self._is_over = False
        # A pipe that is not read would stop the process.
        self._errors = tempfile.TemporaryFile('a+b', buffering=0)  # noqa: SIM115 - it is closed at the end
        self._last_errors = b''
        try:
            self._process = subprocess.Popen(
                line,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._errors,
                start_new_session=True,
            )
        except BaseException:
            self._errors.close()
            raise
        self._poll_later()

    def give_up(self) -> str:
        """Kill the process with its children, and return the reason."""
        self._is_over = True
        self._errors.close()
        try:
            os.killpg(self._process.pid, signal.SIGKILL)
        except ProcessLookupError:
            pass
        except PermissionError:
            return 'the command has not ended, and runs as another user who alone may kill it'
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(KILL_TIMEOUT_S)
        return 'the command has not ended: it was killed'

    def _poll_later(self) -> None:
        later = self._node.deadlines.after(POLL_PERIOD_S)
        later.add_done_callback(lambda _: self._poll())

    def _poll(self) -> None:
        if self._is_over:
            return
        code = self._process.poll()
        if code is None:
            self._limit_errors()
            self._poll_later()
            return
        self._is_over = True
        last = ' '.join(self._end_of_errors().decode(errors='replace').split())
        self._errors.close()
        self._end(f'exit code {code}{f": {last}" if last else ""}' if code else '')

    def _limit_errors(self) -> None:
        """Empty the file of the error output if it is long, but for its end."""
        if os.fstat(self._errors.fileno()).st_size > MAX_ERRORS:
            self._last_errors = self._end_of_errors()
            # The process appends, so it continues at the new end.
            self._errors.truncate(0)

    def _end_of_errors(self) -> bytes:
        self._errors.seek(max(0, self._errors.seek(0, os.SEEK_END) - SHOWN))
        return (self._last_errors + self._errors.read(SHOWN))[-SHOWN:]
