"""FormulaClient: formulas asked from any node, in whichever way its callbacks are run."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from typing import Any, Self

from dyknow_interfaces.action import MonitorFormula, MonitorPlan
from dyknow_interfaces.srv import EvaluateFormula
from rclpy.action import ActionClient
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import QoSProfile
from rclpy.task import Future

from dyknow_common import NO_CONSTRAINTS, SECOND_NS, DyKnowError, ExitCode, StreamConstraints
from dyknow_common.ros import (
    SERVICE,
    NodeAdapter,
    RemoteNode,
    constraints_to_message,
    nanoseconds_to_duration,
    snake_case,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation.answer import Answer, Progress
from dyknow_coordinator.grounding.grounding import Grounding
from dyknow_coordinator.plans.plan import Plan, PlanOutcome, PlanVerdict
from dyknow_coordinator.ros.client.action_call import GRACE, ActionCall, Limits
from dyknow_coordinator.ros.client.answer_messages import answer_from_message, progress_from_message
from dyknow_coordinator.ros.client.plan_monitor import PlanMonitor
from dyknow_coordinator.ros.plans.plan_messages import plan_to_goal, verdict_from_message
from dyknow_coordinator.ros.reporting.evaluation_messages import error_of

COORDINATOR = 'stream_reasoning_coordinator'

DAY = 86_400.0
"""Seconds that a monitored formula is evaluated for, unless the caller says otherwise."""


class Monitor:
    """A formula that is being monitored.

    Attributes:
        outcome: a future of the `Answer`; await it, or look whether it is `done()`.
        taken: a future that is done when the coordinator has taken the formula on, or never will.
    """

    def __init__(self) -> None:
        self.outcome: Future = Future()
        self.taken: Future = Future()
        self.errand: ActionCall | None = None

    def cancel(self) -> None:
        """Wants no verdict any more: the answer is then CANCELLED, unless one is there already."""
        if self.errand is not None:
            self.errand.cancel()


class FormulaClient:
    """Asks the stream reasoning coordinator about formulas.

    What becomes of a formula is always told in an `Answer`, errors too: nothing here raises for
    it, since an exception in a callback would end the executor of the robot, and a formula that
    was not violated in its time (TIMEOUT) is no accident. A script that wants an exception calls
    `answer.check()`.

    Every wait has an end: that for the coordinator (`wait`), that for the verdict (`timeout`, by
    the wall clock, and some grace for the coordinator to say so). If the coordinator dies
    meanwhile, the answer is UNAVAILABLE within seconds.

    The client may be used by callbacks of any executor, with one or several threads. It may be
    made before the node is spun. All its methods but `evaluate_blocking` return at once.

    Args:
        node: any node; the client's callbacks are in groups of their own.
        coordinator: the name of the coordinator, relative to the namespace of the node.
    """

    def __init__(self, node: Node, coordinator: str = COORDINATOR) -> None:
        self._node = node
        self._name = coordinator
        self._guest = NodeAdapter(node)
        self._peer = RemoteNode(self._guest, coordinator)
        self._actions: dict[Any, ActionClient] = {}
        self._errands: set[ActionCall] = set()
        self._closed = False

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Cancels all that is under way, whose answers are then CANCELLED; may be called twice."""
        if self._closed:
            return
        self._closed = True
        for errand in list(self._errands):
            errand.fail(CoordinationError('the client was closed', ExitCode.CANCELLED))
        self._peer.release()
        self._guest.leave()
        for action in self._actions.values():
            action.destroy()

    async def evaluate(
        self,
        formula: str,
        *,
        timeout: float = 60.0,  # noqa: ASYNC109 - the coordinator keeps it, not asyncio
        grounding: Grounding = Grounding.AUTO,
        constraints: StreamConstraints = NO_CONSTRAINTS,
        wait: float = 5.0,
    ) -> Answer:
        """Whether a formula holds from now on, to be awaited by a callback or a task of rclpy.

        What is asked cannot be taken back: it ends at the coordinator by its timeout. What you
        may want to cancel is for `monitor`.

        Args:
            formula: in the formula language.
            timeout: seconds of the wall clock after which the answer is TIMEOUT.
            grounding: how symbols find their streams.
            constraints: of the stream of states.
            wait: seconds to wait for the coordinator to be there.
        """
        try:
            self._check(timeout)
            request = _asked(EvaluateFormula.Request, formula, timeout, grounding, constraints)
            response = await self._peer.request(EvaluateFormula, request, wait, timeout + GRACE)
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
        wait: float = 5.0,
    ) -> Answer:
        """The same as `evaluate`, for scripts, and for threads that do not spin the node.

        The thread that calls it waits; it does not matter whether the node is being spun.

        Raises:
            RuntimeError: in a callback of an executor of one thread, which could do nothing else
                meanwhile; there, await `evaluate`.
        """
        _refuse_in_callback(self._node)
        if self._closed:
            return Answer(error=_closed())
        helper = _helper(self._node)
        executor = SingleThreadedExecutor(context=self._node.context)
        executor.add_node(helper)
        try:
            with FormulaClient(helper, self._name) as client:
                asking = executor.create_task(
                    client.evaluate,
                    formula,
                    timeout=timeout,
                    grounding=grounding,
                    constraints=constraints,
                    wait=wait,
                )
                executor.spin_until_future_complete(asking)
                return asking.result() or Answer(error=_closed())
        finally:
            executor.shutdown()
            helper.destroy_node()

    def monitor(
        self,
        formula: str,
        *,
        on_verdict: Callable[[Answer], Any] = lambda _: None,
        on_feedback: Callable[[Progress], Any] = lambda _: None,
        name: str = '',
        restart_on_change: bool = False,
        timeout: float = DAY,
        grounding: Grounding = Grounding.AUTO,
        constraints: StreamConstraints = NO_CONSTRAINTS,
        wait: float = 5.0,
    ) -> Monitor:
        """Has a formula evaluated from now on, while the node does other things.

        Args:
            formula: in the formula language.
            on_verdict: is given the answer, once, whatever it is; may be `async`.
            on_feedback: is told after states how it goes.
            name: what operators see; empty for the formula itself.
            restart_on_change: begin anew when a sort of the formula gets or loses objects.
            timeout: seconds of the wall clock after which the answer is TIMEOUT.
            grounding: how symbols find their streams.
            constraints: of the stream of states.
            wait: seconds to wait for the coordinator to be there.
        """
        monitor = Monitor()

        def end(result: Any, error: DyKnowError | None) -> None:
            answer = Answer(error=error) if error is not None else answer_from_message(result)
            monitor.outcome.set_result(answer)
            if monitor.errand is None:
                monitor.taken.set_result(None)
            _tell(self._node, on_verdict, answer)

        try:
            self._check(timeout)
        except DyKnowError as error:
            end(None, error)
            return monitor
        goal = _asked(MonitorFormula.Goal, formula, timeout, grounding, constraints)
        goal.name, goal.restart_on_change = name, restart_on_change
        monitor.errand = self._send(
            MonitorFormula,
            goal,
            Limits(wait, timeout),
            end,
            lambda feedback: on_feedback(progress_from_message(feedback)),
        )
        monitor.errand.accepted.add_done_callback(lambda _: monitor.taken.set_result(None))
        return monitor

    def monitor_plan(
        self,
        plan: Plan,
        *,
        on_verdict: Callable[[PlanVerdict], Any] = lambda _: None,
        grounding: Grounding = Grounding.AUTO,
        constraints: StreamConstraints = NO_CONSTRAINTS,
        wait: float = 5.0,
    ) -> PlanMonitor:
        """Has the execution of a plan monitored, which the caller reports to the handle.

        Args:
            plan: its name must be unique among those that are monitored.
            on_verdict: is told of every change of what is known of a formula.
            grounding: how symbols find their streams.
            constraints: of the states of all formulas.
            wait: seconds to wait for the coordinator to be there.
        """
        monitor = PlanMonitor(plan.name, self._peer, on_verdict)

        def end(result: Any, error: DyKnowError | None) -> None:
            verdicts = () if result is None else map(verdict_from_message, result.verdicts)
            failure = error if result is None else error_of(result.exit_status)
            monitor.end(PlanOutcome(tuple(verdicts), failure))

        if self._closed:
            end(None, _closed())
            return monitor
        goal = plan_to_goal(plan)
        goal.grounding, goal.constraints = int(grounding), constraints_to_message(constraints)
        monitor.errand = self._send(
            MonitorPlan,
            goal,
            Limits(wait, None),
            end,
            lambda feedback: monitor.tell(verdict_from_message(feedback.verdict)),
        )
        return monitor

    def _send(
        self,
        action_type: Any,
        goal: Any,
        limits: Limits,
        on_end: Callable[[Any, DyKnowError | None], None],
        on_feedback: Callable[[Any], None],
    ) -> ActionCall:
        def end(result: Any, error: DyKnowError | None) -> None:
            self._errands.discard(errand)
            on_end(result, error)

        errand = ActionCall(
            self._guest,
            self._peer,
            self._action(action_type),
            goal,
            limits,
            on_end=end,
            on_feedback=on_feedback,
        )
        self._errands.add(errand)
        return errand

    def _action(self, action_type: Any) -> ActionClient:
        if action_type not in self._actions:
            self._actions[action_type] = ActionClient(
                self._node,
                action_type,
                f'{self._name}/{snake_case(action_type.__name__)}',
                callback_group=MutuallyExclusiveCallbackGroup(),
                goal_service_qos_profile=SERVICE,
                result_service_qos_profile=SERVICE,
                cancel_service_qos_profile=SERVICE,
                feedback_sub_qos_profile=QoSProfile(depth=SERVICE.depth),
            )
        return self._actions[action_type]

    def _check(self, timeout: float) -> None:
        if self._closed:
            raise _closed()
        if timeout <= 0:
            raise CoordinationError(f'the timeout of {timeout:g} s is not above 0; give it more')


def _closed() -> CoordinationError:
    return CoordinationError('the client is closed; make another one', ExitCode.CANCELLED)


def _asked(
    message_type: Any,
    formula: str,
    timeout: float,
    grounding: Grounding,
    constraints: StreamConstraints,
) -> Any:
    return message_type(
        formula=formula,
        grounding=int(grounding),
        constraints=constraints_to_message(constraints),
        timeout=nanoseconds_to_duration(round(timeout * SECOND_NS)),
    )


def _helper(node: Node) -> Node:
    """A hidden node beside another one, for a thread that waits."""
    return Node(
        f'_{node.get_name()}_formula_client',
        context=node.context,
        namespace=node.get_namespace(),
        use_global_arguments=False,
        start_parameter_services=False,
        enable_rosout=False,
    )


def _refuse_in_callback(node: Node) -> None:
    """Raises when this thread is inside the executor of the node: to wait would stop them both."""
    executor = node.executor
    frame = inspect.currentframe()
    while executor is not None and frame is not None:
        # An executor of several threads spins in one and runs callbacks in others.
        if frame.f_code.co_name.startswith('spin') and frame.f_locals.get('self') is executor:
            raise RuntimeError(
                'evaluate_blocking was called in a callback, and would keep the executor from '
                'running any other; await evaluate, or use monitor'
            )
        frame = frame.f_back


def _tell(node: Node, listener: Callable[[Answer], Any], answer: Answer) -> None:
    """Calls a listener, which may be `async`."""
    if not inspect.iscoroutinefunction(listener):
        listener(answer)
        return
    executor = node.executor
    if executor is not None and node in executor.get_nodes():
        executor.create_task(listener, answer)
    else:
        warnings.warn(f'nobody spins the node, so {listener} is not run', stacklevel=2)
