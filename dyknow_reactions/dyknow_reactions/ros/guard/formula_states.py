"""The states of one formula of a guard: asked for at the coordinator, read from their stream.

The coordinator grounds the formula and has its states made, as for any monitored formula. The guard
subscribes to the same stream of states, and decides itself: the way of a verdict by the reasoning
engine and the coordinator would be longer.

    0.0 s  the goal of MonitorFormula is sent
    0.4 s  ~/evaluations: it is RUNNING, with the stream states_1; the objects of its sorts are read
    0.5 s  the first state of states_1 is received
    9.0 s  a violation of states_1, or ~/evaluations: it is INTERRUPTED. No state counts any more
    9.2 s  ~/evaluations: it is RUNNING, with states_2; all begins anew. Otherwise, the goal ends
           with an error, and is sent again after RETRY_DELAY_S

If the formula cannot be asked of states any more, or these cannot be read, while the coordinator
finds no fault in them, the goal is cancelled after RESUME_TIMEOUT_S, and sent again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Any, Final, NamedTuple, Protocol

from dyknow_common import DyKnowError, Value
from dyknow_common.ros import DyKnowNode, RemoteNode
from dyknow_coordinator import Answer
from dyknow_coordinator.ros import FormulaClient, Monitor
from dyknow_coordinator.ros.reporting.evaluation_messages import status_from_message
from dyknow_reactions.guard.state_source import StateSource, latest_source, why_unusable
from dyknow_reactions.ros.formula_objects import objects_of, unknown_of
from dyknow_reasoning import Breach, StateLine, UnknownFeatures
from dyknow_reasoning.ros.state_subscription import State, StateSubscription
from dyknow_stream_processing.ros import sample_fields

RETRY_DELAY_S: Final = 0.5
"""The time until a formula is asked again after its evaluation has ended."""

RESUME_TIMEOUT_S: Final = 4.0
"""The time within which the coordinator must replace states that cannot be used."""


class StateReceiver(Protocol):
    """A formula of a guard, which receives its states."""

    @property
    def crosses_gaps(self) -> bool:
        """True if it goes on with another stream of the same evaluation, after a gap."""

    def begin(
        self, formula: str, domains: Mapping[str, Sequence[str]], unknown: UnknownFeatures
    ) -> None:
        """Begin with the states of another stream.

        Args:
            formula: the formula that is asked.
            domains: the objects of its sorts.
            unknown: the features that may be unknown.

        Raises:
            DyKnowError: if the formula cannot be asked of them.
        """

    def gap(self) -> None:
        """Record that states may be missing before the next one."""

    def receive(self, valid_time: int, values: Mapping[str, Value]) -> None:
        """Receive a state; raise a DyKnowError if the formula cannot be asked any more."""

    def fail(self, reason: str) -> None:
        """Receive the reason why there are no states that can be used."""


class StateServices(NamedTuple):
    """Parts that all formulas of a guard share.

    Args:
        node: the guard.
        client: the client of the coordinator.
        ontology: the ontology manager.
    """

    node: DyKnowNode
    client: FormulaClient
    ontology: RemoteNode


class FormulaStates:
    """The states of one formula, from one evaluation after the other.

    A `StateLine` decides which states of an evaluation count, as in the reasoning engine.

    Args:
        services: the services that it uses.
        formula: its text.
        name: the name of the evaluation, unique in the system.
        receiver: the receiver of the states.
        every_state: True if operators see the verdicts from all states.
    """

    def __init__(
        self,
        services: StateServices,
        formula: str,
        name: str,
        receiver: StateReceiver,
        *,
        every_state: bool,
    ) -> None:
        self._services = services
        self._formula = formula
        self._name = name
        self._receiver = receiver
        self._every_state = every_state
        self._source: StateSource | None = None
        self._states: StateSubscription | None = None
        self._used = StateSource(0, 0, '', '')
        self._line = self._new_line()
        # The former stream, until a state of the next stream has come: its violation closes the
        # gate all the same, even if the guard learns of the violation after the states.
        self._former: StateSubscription | None = None
        self._monitor: Monitor | None = None
        self._ask()

    def note_evaluations(self, statuses: Iterable[Any]) -> None:
        """Take the reports of the coordinator on all evaluations."""
        own = [status_from_message(each) for each in statuses if each.name == self._name]
        if self._states is not None and (reason := why_unusable(self._used, own)):
            self._give_up(reason)
        latest = latest_source(own)
        if latest is not None and latest != self._source:
            self._source = latest
            self._services.node.spawn(self._begin, latest)

    def _ask(self) -> None:
        self._monitor = self._services.client.monitor(
            self._formula,
            on_verdict=self._on_end,
            name=self._name,
            every_state=self._every_state,
            restart_on_change=True,
        )

    def _on_end(self, answer: Answer) -> None:
        node = self._services.node
        if not node.context.ok():
            return
        reason = answer.explanation if answer.error is None else answer.error.message
        self._stop(f'its evaluation has ended: {reason}')
        node.deadlines.after(RETRY_DELAY_S).add_done_callback(lambda _: self._ask())

    async def _begin(self, source: StateSource) -> None:
        """Subscribe to the states of an evaluation, once the objects of its sorts are known."""
        try:
            domains = await objects_of(self._services.ontology, source.formula)
            unknown = await unknown_of(self._services.ontology, source.formula)
            if source != self._source:
                return  # There are newer states.
            if not (self._receiver.crosses_gaps and source.is_same_group(self._used)):
                self._receiver.begin(source.formula, domains, unknown)
        except DyKnowError as error:
            if source == self._source:
                self._give_up(error.message)
            return
        self._leave_states()
        if not source.is_same_group(self._used):
            self._line = self._new_line()
        self._used = source
        node = self._services.node
        self._states = StateSubscription(node, source.stream, self._on_state, self._on_breach)
        self._line.change(self._states, node.now())

    def _new_line(self) -> StateLine[StateSubscription]:
        return StateLine(lambda _: self._receiver.gap())

    def _on_state(self, states: StateSubscription, state: State) -> None:
        if states is not self._states:
            return
        if not self._line.receive(state.valid_time, is_after_loss=bool(state.loss)):
            return
        self._destroy_former()
        try:
            self._receiver.receive(state.valid_time, sample_fields(state.message))
        except DyKnowError as error:
            self._give_up(error.message)

    def _on_breach(self, states: StateSubscription, breach: Breach) -> None:
        if states is self._states:
            self._give_up(breach.message)
        elif states is self._former:
            self._receiver.fail(breach.message)

    def _give_up(self, reason: str) -> None:
        """Stop reading states, and ask anew unless the coordinator soon reports others."""
        self._stop(reason)
        source, monitor = self._source, self._monitor
        due = self._services.node.deadlines.after(RESUME_TIMEOUT_S)

        def ask_anew(_: object) -> None:
            if source == self._source and monitor is self._monitor and monitor is not None:
                monitor.cancel()

        due.add_done_callback(ask_anew)

    def _stop(self, reason: str) -> None:
        """Read no more states, until the coordinator reports others."""
        self._leave_states()
        self._receiver.fail(reason)

    def _leave_states(self) -> None:
        if self._states is not None:
            self._destroy_former()
            self._former, self._states = self._states, None

    def _destroy_former(self) -> None:
        if self._former is not None:
            self._former.destroy()
            self._former = None
