"""FormulaClient: evaluate formulas from any node, with any executor."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from math import inf
from numbers import Real
from types import NoneType
from typing import Any, Final, Self, cast

from dyknow_interfaces.action import MonitorFormula, MonitorPlan
from dyknow_interfaces.srv import EvaluateFormula
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future

from dyknow_common import (
    MAX_DURATION_NS,
    NO_CONSTRAINTS,
    SECOND_NS,
    BlackBoxOptions,
    DyKnowError,
    ExitCode,
    StreamConstraints,
)
from dyknow_common.ros import (
    SERVICE,
    NodeAdapter,
    RemoteNode,
    constraints_to_message,
    error_from_message,
    nanoseconds_to_duration,
    snake_case,
    to_message,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import Answer, EvaluationRequest, Progress
from dyknow_coordinator.grounding.feature_sources import Grounding
from dyknow_coordinator.plan import Plan, PlanOutcome, PlanVerdict
from dyknow_coordinator.ros.answers import (
    answer_from_message,
    progress_from_message,
    verdict_from_message,
)
from dyknow_coordinator.ros.client.action_call import (
    GRACE_S,
    ActionCall,
    ActionCaller,
    GoalTimeouts,
)
from dyknow_coordinator.ros.client.formula_attempts import (
    FormulaAttempts,
    answer_of_goal,
    notify_listener,
)
from dyknow_coordinator.ros.client.plan_monitor import PlanMonitor

COORDINATOR: Final = 'stream_reasoning_coordinator'

MAX_S: Final = MAX_DURATION_NS // SECOND_NS
"""The longest timeout and wait, which a message of ROS holds."""

DAY_S: Final = 86_400.0
"""Default timeout of a monitored formula."""

_TYPES: Final[Mapping[str, tuple[Any, str]]] = {
    'formula': (str, 'a text in the formula language'),
    'name': (str, 'a text'),
    'timeout': (Real, 'a number of seconds'),
    'wait': (Real, 'a number of seconds'),
    'grounding': (Grounding, 'a member of Grounding, such as Grounding.AUTO'),
    'constraints': (StreamConstraints, 'a StreamConstraints'),
    'plan': (Plan, 'a Plan'),
    'record': (BlackBoxOptions | NoneType, 'a BlackBoxOptions or None'),
    'node': (Node, 'a node of rclpy'),
    'coordinator': (str, 'the name of a node'),
    **dict.fromkeys(('margin', 'every_state', 'restart_on_change'), (bool, 'True or False')),
    **dict.fromkeys(('on_verdict', 'on_feedback'), (Callable, 'a function')),
    'on_interruption': (Callable | NoneType, 'a function or None'),
}
"""The type of each argument, and the words for it."""


class Monitor:
    """Handle of a formula that is being monitored.

    Attributes:
        outcome: a future of the `Answer`; await it, or check `done()`.
        accepted: a future that is done when the coordinator has accepted the formula, or never
            will.
    """

    def __init__(self) -> None:
        self.outcome: Future = Future()
        self.accepted: Future = Future()
        self.call: FormulaAttempts | None = None

    def cancel(self) -> None:
        """End the evaluation: unless there is an answer already, it is then CANCELLED."""
        if self.call is not None:
            self.call.cancel()


class FormulaClient:
    """Client of the stream reasoning coordinator.

    Errors are part of the `Answer`, not raised: an exception in a callback would end the executor,
    and a formula that was not violated in its time (TIMEOUT) is normal. A script that needs an
    exception calls `answer.check()`.

    Every wait ends. The wait for the coordinator ends after `wait`. The wait until it accepts the
    formula ends after another 5 s; it accepts hundreds at once in that time. The wait for the
    verdict ends after `timeout` and a grace period, or within seconds, with UNAVAILABLE, if the
    coordinator dies.

    A wrong argument is a fault of the caller: a TypeError or a ValueError names it.

    The client works in callbacks of any executor, single-threaded or multi-threaded, and may be
    created before the node is spun. All methods but `evaluate_blocking` return at once.

    Options:

    - formula: in the formula language.
    - timeout: seconds of the wall clock after which the answer is TIMEOUT.
    - grounding: how symbols find their streams.
    - constraints: of the state stream.
    - margin: also compute how far the formula is from the change of its verdict.
    - wait: seconds to wait for the coordinator to be available.
    - name: shown to operators; by default the formula.
    - restart_on_change: restart when a sort of the formula gains or loses objects.
    - every_state: ask the formula at every state, until the timeout or `Monitor.cancel`.
    - record: the black box that is recorded when the formula fails; None for none.

    Args:
        node: any node; the client has callback groups of its own.
        coordinator: the name of the coordinator, relative to the namespace of the node.
    """

    def __init__(self, node: Node, coordinator: str = COORDINATOR) -> None:
        check_arguments(node=node, coordinator=coordinator)
        self._node = node
        self._name = coordinator
        self._adapter = NodeAdapter(node)
        self._coordinator = RemoteNode(self._adapter, coordinator)
        self._goals = CoordinatorGoals(self._adapter, self._coordinator)
        self._attempts: set[FormulaAttempts] = set()
        self._is_closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Cancel all requests, whose answers are then CANCELLED; may be called twice."""
        if self._is_closed:
            return
        self._is_closed = True
        self._goals.close(CoordinationError('the client was closed', ExitCode.CANCELLED))
        for attempts in list(self._attempts):
            attempts.cancel()
        self._coordinator.release()
        self._adapter.close()

    async def evaluate(
        self,
        formula: str,
        *,
        timeout: float = 60.0,  # noqa: ASYNC109 - the coordinator keeps it, not asyncio
        grounding: Grounding = Grounding.AUTO,
        constraints: StreamConstraints = NO_CONSTRAINTS,
        margin: bool = False,
        wait: float = 5.0,
    ) -> Answer:
        """Evaluate a formula from now on, awaited by a callback or a task of rclpy.

        The request cannot be cancelled; it ends after its timeout. See `monitor` for others.
        """
        check_arguments(formula=formula, timeout=timeout, grounding=grounding)
        check_arguments(constraints=constraints, wait=wait, margin=margin)
        refusal = self._refusal(timeout, constraints)
        if refusal is not None:
            return Answer(error=refusal)
        try:
            content = EvaluationRequest(formula, grounding, constraints, margin=margin)
            request = to_message(content, EvaluateFormula.Request(timeout=_duration(timeout)))
            response = await self._coordinator.request(
                EvaluateFormula, request, wait, timeout + GRACE_S
            )
        except DyKnowError as error:
            return Answer(error=error)
        return answer_from_message(response)

    def evaluate_blocking(
        self,
        formula: str,
        *,
        timeout: float = 60.0,
        grounding: Grounding = Grounding.AUTO,
        constraints: StreamConstraints = NO_CONSTRAINTS,
        margin: bool = False,
        wait: float = 5.0,
    ) -> Answer:
        """Evaluate a formula from now on; the thread waits, whether the node is spun or not.

        Raises:
            RuntimeError: in a callback of a single-threaded executor, which would be blocked;
                await `evaluate` there.
            ExternalShutdownException: if rclpy is shut down meanwhile.
        """
        check_arguments(formula=formula, timeout=timeout, grounding=grounding)
        check_arguments(constraints=constraints, wait=wait, margin=margin)
        refuse_in_callback(self._node)
        if (refusal := self._refusal(timeout, constraints)) is not None:
            return Answer(error=refusal)
        helper = helper_node(self._node)
        executor = SingleThreadedExecutor(context=self._node.context)
        executor.add_node(helper)
        try:
            with FormulaClient(helper, self._name) as client:
                task = executor.create_task(
                    client.evaluate, formula,
                    timeout=timeout,
                    grounding=grounding,
                    constraints=constraints,
                    margin=margin,
                    wait=wait,
                )  # fmt: skip
                executor.spin_until_future_complete(task)
                return task.result() or Answer(error=_closed())
        finally:
            executor.shutdown()
            helper.destroy_node()

    def monitor(
        self,
        formula: str,
        *,
        on_verdict: Callable[[Answer], Any] = lambda _: None,
        on_feedback: Callable[[Progress], Any] = lambda _: None,
        on_interruption: Callable[[Answer], Any] | None = None,
        name: str = '',
        restart_on_change: bool = False,
        every_state: bool = False,
        timeout: float = DAY_S,
        grounding: Grounding = Grounding.AUTO,
        constraints: StreamConstraints = NO_CONSTRAINTS,
        margin: bool = False,
        record: BlackBoxOptions | None = None,
        wait: float = 5.0,
    ) -> Monitor:
        """Evaluate a formula from now on, in the background.

        `on_verdict` (may be `async`) gets the answer or an error; `on_feedback`, reports meanwhile.
        With `on_interruption`, which gets the error, broken constraints are not the end of it.
        """
        # Here, the local variables are the arguments.
        check_arguments(**{name: value for name, value in locals().items() if value is not self})
        monitor = Monitor()
        if (refusal := self._refusal(timeout, constraints)) is not None:
            monitor.accepted.set_result(None)
            self._end(monitor, on_verdict, Answer(error=refusal))
            return monitor
        content = EvaluationRequest(formula, grounding, constraints, margin=margin, record=record)
        goal = to_message(content, MonitorFormula.Goal())
        goal.name, goal.every_state, goal.restart_on_change = name, every_state, restart_on_change
        call = FormulaAttempts(
            self._adapter,
            timeout,
            partial(self._send_formula, goal, wait, on_feedback),
            partial(self._end, monitor, on_verdict),
            on_interruption and partial(notify_listener, self._node, on_interruption),
        )
        return self._added(monitor, call)

    def _added(self, monitor: Monitor, call: FormulaAttempts) -> Monitor:
        monitor.call = call
        self._attempts.add(call)
        call.call.accepted.add_done_callback(lambda _: monitor.accepted.set_result(None))
        return monitor

    def _send_formula(
        self,
        goal: Any,
        wait: float,
        on_feedback: Callable[[Progress], Any],
        longest_wait: float,
        timeout: Callable[[], float],
        on_end: Callable[[Answer], None],
    ) -> ActionCall:
        every_state = goal.every_state

        def timed() -> Any:
            goal.timeout = _duration(timeout())
            return goal

        return self._goals.send(
            MonitorFormula,
            timed,
            GoalTimeouts(min(wait, longest_wait), timeout()),
            lambda result, error: on_end(answer_of_goal(result, error, every_state=every_state)),
            lambda each: on_feedback(progress_from_message(each, every_state=every_state)),
        )

    def _end(self, monitor: Monitor, on_verdict: Callable[[Answer], Any], answer: Answer) -> None:
        if monitor.call is not None:
            self._attempts.discard(monitor.call)
        monitor.outcome.set_result(answer)
        notify_listener(self._node, on_verdict, answer)

    def monitor_plan(
        self,
        plan: Plan,
        *,
        on_verdict: Callable[[PlanVerdict], Any] = lambda _: None,
        grounding: Grounding = Grounding.AUTO,
        constraints: StreamConstraints = NO_CONSTRAINTS,
        wait: float = 5.0,
    ) -> PlanMonitor:
        """Monitor the execution of a plan, whose progress the caller reports to the handle.

        `on_verdict` is called for every change of the status of a formula. The other options apply
        to all formulas.
        """
        check_arguments(plan=plan, on_verdict=on_verdict)
        check_arguments(grounding=grounding, constraints=constraints, wait=wait)
        monitor = PlanMonitor(plan.name, self._coordinator, on_verdict)

        def end(result: Any, error: DyKnowError | None) -> None:
            verdicts = () if result is None else map(verdict_from_message, result.verdicts)
            failure = error if result is None else error_from_message(result.exit_status)
            monitor.end(PlanOutcome(tuple(verdicts), failure))

        if self._is_closed:
            end(None, _closed())
            return monitor
        goal = to_message(plan, MonitorPlan.Goal())
        goal.grounding, goal.constraints = int(grounding), constraints_to_message(constraints)
        monitor.call = self._goals.send(
            MonitorPlan,
            lambda: goal,
            GoalTimeouts(wait, None),
            end,
            lambda feedback: monitor.update(verdict_from_message(feedback.verdict)),
        )
        return monitor

    def _refusal(self, timeout_s: float, constraints: StreamConstraints) -> DyKnowError | None:
        """Return the reason why a request cannot be sent, if there is one."""
        if self._is_closed:
            return _closed()
        if timeout_s <= 0:
            return CoordinationError(f'the timeout of {timeout_s:g} s is not above 0; give it more')
        try:
            constraints_to_message(constraints)
        except DyKnowError as error:
            return error
        return None


def _closed() -> CoordinationError:
    return CoordinationError('the client is closed; make another one', ExitCode.CANCELLED)


def _duration(seconds: float) -> Any:
    return nanoseconds_to_duration(round(seconds * SECOND_NS))


def helper_node(node: Node) -> Node:
    """Return a hidden node beside another one, for a thread that waits."""
    return Node(
        f'_{node.get_name()}_formula_client',
        context=node.context,
        namespace=node.get_namespace(),
        use_global_arguments=False,
        start_parameter_services=False,
        enable_rosout=False,
    )


def refuse_in_callback(node: Node) -> None:
    """Raise an error if this thread is inside the executor of the node: both would wait."""
    executor = node.executor
    frame = inspect.currentframe()
    while executor is not None and frame is not None:
        # A multi-threaded executor spins in one thread and runs callbacks in others.
        if frame.f_code.co_name.startswith('spin') and frame.f_locals.get('self') is executor:
            raise RuntimeError(
                'evaluate_blocking was called in a callback, and would block the executor; '
                'await evaluate, or use monitor'
            )
        frame = frame.f_back


class CoordinatorGoals:
    """Sends goals to the coordinator, with one action client for each action.

    Args:
        node: the node that sends.
        coordinator: the coordinator.
    """

    def __init__(self, node: NodeAdapter, coordinator: RemoteNode) -> None:
        self._node = node
        self._coordinator = coordinator
        self._actions: dict[Any, ActionCaller] = {}
        self._calls: set[ActionCall] = set()

    def send(
        self,
        action_type: Any,
        goal: Callable[[], Any],
        timeouts: GoalTimeouts,
        on_end: Callable[[Any, DyKnowError | None], None],
        on_feedback: Callable[[Any], None],
    ) -> ActionCall:
        """Send a goal; see `ActionCall`."""

        def end(result: Any, error: DyKnowError | None) -> None:
            self._calls.discard(call)
            on_end(result, error)

        call = ActionCall(
            self._node,
            self._coordinator,
            self._action(action_type),
            goal,
            timeouts,
            on_end=end,
            on_feedback=on_feedback,
        )
        self._calls.add(call)
        return call

    def close(self, error: DyKnowError) -> None:
        """End all calls with an error, also the goals that the coordinator accepts later."""
        calls = list(self._calls)
        for call in calls:
            call.fail(error)
            call.on_answered = lambda: self._destroy_actions(calls)
        self._destroy_actions(calls)

    def _destroy_actions(self, calls: Sequence[ActionCall]) -> None:
        """Destroy the action clients, unless some calls are unanswered.

        A client that is destroyed at once may lose the request to cancel a goal, and cannot cancel
        one that is accepted later. The coordinator would evaluate its formula until its timeout.
        """
        if not any(each.is_unanswered for each in calls):
            while self._actions:
                self._actions.popitem()[1].destroy()

    def _action(self, action_type: Any) -> ActionCaller:
        if action_type not in self._actions:
            self._actions[action_type] = ActionCaller(
                self._node.node,
                action_type,
                f'{self._coordinator.name}/{snake_case(action_type.__name__)}',
                callback_group=MutuallyExclusiveCallbackGroup(),
                goal_service_qos_profile=SERVICE,
                result_service_qos_profile=SERVICE,
                cancel_service_qos_profile=SERVICE,
                feedback_sub_qos_profile=QoSProfile(depth=SERVICE.depth),
            )
        return self._actions[action_type]


def check_arguments(**arguments: object) -> None:
    """Check arguments; rclpy would not say which one is wrong, or only when they are used.

    Raises:
        TypeError: names the argument of a wrong type.
        ValueError: names the time that is not finite or too long, or a wait that is negative.
    """
    for name, value in arguments.items():
        expected, words = _TYPES[name]
        if not isinstance(value, expected) or (expected is not bool and isinstance(value, bool)):
            raise TypeError(f'{name} must be {words}, not {value!r}')
        if isinstance(value, Real):
            _check_seconds(name, cast('float', value))


def _check_seconds(name: str, value: float) -> None:
    if not abs(value) < inf:
        raise ValueError(f'{name} must be a finite number of seconds, not {value!r}')
    if value > MAX_S:
        raise ValueError(f'{name} must be at most {MAX_S} s (68 years), not {value!r}')
    if name == 'wait' and value < 0:
        raise ValueError(f'wait must not be negative, but it is {value!r}')
