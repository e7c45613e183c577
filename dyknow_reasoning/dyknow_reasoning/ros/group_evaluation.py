"""The evaluation of one formula group over one stream of states after another."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from dyknow_interfaces.msg import FormulaProgress
from dyknow_interfaces.msg import FormulaResult as FormulaResultMessage

from dyknow_common import SECOND_NS, DyKnowError, ExitCode
from dyknow_common.ros import (
    LATCHED_HISTORY,
    NO_PUBLISHER_EVENTS,
    DyKnowNode,
    fill_exit_status,
    nanoseconds_to_time,
)
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.formula_group import FormulaGroup
from dyknow_reasoning.progression.gaps import Gap
from dyknow_reasoning.results import FormulaResult
from dyknow_reasoning.ros.state_subscription import Breach, State, StateSubscription, check_topic
from dyknow_stream_processing.ros import sample_fields

_MOST_WAITING = 1000
_MOST_EVENTS = 20


@dataclass(frozen=True, slots=True)
class Pause:
    """Nothing is progressed since a stream broke a constraint.

    Args:
        since: by the wall clock, in nanoseconds.
        breach: what was broken.
    """

    since: int
    breach: Breach


class GroupEvaluation:
    """One formula group and the stream of states that it is progressed over.

    While it goes over to another stream, the states of that one wait until the former has come as
    far, so that none is lost.
    """

    def __init__(self, node: DyKnowNode, group_id: int, name: str, group: FormulaGroup) -> None:
        self.group = group
        self.name = name
        self._node = node
        self._id = group_id
        self._states = 0
        # How many states came before each formula.
        self._states_before: dict[int, int] = {}
        self._latest: int | None = None
        self._events: deque[str] = deque(maxlen=_MOST_EVENTS)
        self._domains: Mapping[str, Sequence[str]] = {}
        self._result_topic = ''
        self._results: Any = None
        self._current: StateSubscription | None = None
        self._next: StateSubscription | None = None
        self._waiting: list[State] = []
        self._pause: Pause | None = None
        # Whether states may come that the former stream has brought already, and how many did.
        self._catches_up = False
        self._skipped = 0
        self._wanted_at = self._wall_time()

    @property
    def has_begun(self) -> bool:
        """Whether it is evaluated."""
        return self._current is not None

    def add_formula(self, name: str, text: str) -> int:
        """Adds a formula, that begins with the next state, and returns its id.

        Raises:
            LanguageError: as `FormulaGroup.add_formula` does.
            ReasoningError: likewise.
        """
        formula_id = self.group.add_formula(name, text)
        self._states_before[formula_id] = self._states
        if self.has_begun:
            self.publish(self.group.decided_at_once())
        return formula_id

    def remove_formula(self, formula_id: int) -> None:
        """Takes a formula out.

        Raises:
            ReasoningError: for an unknown formula.
        """
        self.group.remove_formula(formula_id)
        del self._states_before[formula_id]

    def begin(
        self, domains: Mapping[str, Sequence[str]], state_stream: str, result_topic: str
    ) -> None:
        """Fixes the domains and listens to the states.

        Raises:
            ReasoningError: when a topic has no valid name or a sort no domain.
        """
        check_topic('state_stream', state_stream)
        check_topic('result_topic', result_topic)
        self.group.begin(domains)
        self._domains, self._result_topic = domains, result_topic
        self._results = self._node.create_publisher(
            FormulaResultMessage,
            result_topic,
            LATCHED_HISTORY,
            event_callbacks=NO_PUBLISHER_EVENTS,
        )
        self.publish(self.group.decided_at_once())
        self._current = self._stream(state_stream)

    def go_over(
        self,
        domains: Mapping[str, Sequence[str]],
        state_stream: str,
        result_topic: str,
        *,
        gap: bool,
    ) -> None:
        """Goes over to another stream of states, or stays with the present one after all.

        Args:
            domains: none, or what they are.
            state_stream: the topic of the new states.
            result_topic: empty, or what it is.
            gap: whether states may be missing between the former stream's and the new one's.

        Raises:
            ReasoningError: when the topic has no valid name, or domains or result topic are others.
        """
        check_topic('state_stream', state_stream)
        self._check_same(domains, result_topic)
        if self._next:
            self._next.destroy()
        self._next, self._waiting = None, []
        stays = self._current and self._current.topic == state_stream
        if stays and not (gap or self._pause):
            return
        self._next = self._stream(state_stream)
        if self._latest is None or gap or self._pause:
            self._switch(gap=True)

    def end(self) -> None:
        """Frees what listens and publishes."""
        for stream in (self._current, self._next):
            if stream:
                stream.destroy()
        if self._results is not None:
            self._node.destroy_publisher(self._results)

    def touch(self) -> None:
        """Takes note that somebody asks for the group."""
        self._wanted_at = self._wall_time()

    def is_orphan(self, limit: float) -> bool:
        """Whether nobody has asked for the group, or listened to its results, for some seconds."""
        if self._results is not None and self._results.get_subscription_count() > 0:
            self.touch()
        return self._wall_time() - self._wanted_at > limit * SECOND_NS

    def end_patience(self, limit: float) -> None:
        """Gives up all formulas when nobody has come to help for some seconds after a violation."""
        pause = self._pause
        if pause and self.group.undecided and self._wall_time() - pause.since > limit * SECOND_NS:
            error = ReasoningError(pause.breach.message, ExitCode.CONSTRAINT_VIOLATION)
            self.publish(self.group.fail(error, pause.breach.valid_time))

    def progress_reports(self) -> Iterable[Any]:
        """How far each undecided formula has come, and what has happened since the last reports."""
        events = list(self._events)
        self._events.clear()
        for formula_id in sorted(self.group.undecided):
            states = self._states - self._states_before[formula_id]
            latest = self._latest if states else None
            yield FormulaProgress(
                formula_group_id=self._id,
                formula_id=formula_id,
                states_progressed=states,
                latest_valid_time=nanoseconds_to_time(latest or 0),
                residual_formula=self.group.residual(formula_id),
                presumably_false=self.group.presumably_false(formula_id),
                events=events,
            )

    def publish(self, results: Iterable[FormulaResult]) -> None:
        """Tells what has been decided, or has failed."""
        for result in results:
            self._results.publish(self._message(result))

    def _wall_time(self) -> int:
        return int(self._node.wall_clock.now().nanoseconds)

    def _stream(self, topic: str) -> StateSubscription:
        return StateSubscription(self._node, topic, self._receive, self._suffer)

    def _check_same(self, domains: Mapping[str, Sequence[str]], result_topic: str) -> None:
        for sort, objects in domains.items():
            if objects != self._domains.get(sort):
                was = ', '.join(self._domains.get(sort, ())) or 'none'
                raise ReasoningError(
                    f"domains: the objects of the sort '{sort}' are fixed while the group is "
                    f'evaluated ({was}); make a new group for others'
                )
        if result_topic not in {'', self._result_topic}:
            raise ReasoningError(
                f"result_topic: the group publishes its results on '{self._result_topic}' as long "
                f"as it is evaluated, not on '{result_topic}'"
            )

    def _receive(self, stream: StateSubscription, state: State) -> None:
        if stream is self._current:
            self._take(state)
        elif stream is self._next:
            self._waiting.append(state)
        if self._next and self._has_caught_up():
            self._switch(gap=False)
        elif self._next and len(self._waiting) >= _MOST_WAITING:
            self._node.get_logger().warning(
                f"the group '{self.name}' goes over to '{self._next.topic}' with a gap: the former "
                f'stream has not come as far as the {len(self._waiting)} states that wait'
            )
            self._switch(gap=True)

    def _has_caught_up(self) -> bool:
        """Whether the former stream has brought all states before those that wait."""
        latest = self._latest
        return latest is not None and any(state.valid_time <= latest for state in self._waiting[:1])

    def _switch(self, *, gap: bool) -> None:
        """Takes the states of the next stream from now on, first those that wait."""
        if self._current:
            self._current.destroy()
        self._current, self._next = self._next, None
        self._pause = None
        self._catches_up = self._latest is not None
        if gap and self._latest is not None:
            self.group.gap()
        waiting, self._waiting = self._waiting, []
        breach = self._current and self._current.breach
        if breach:
            self._rest(breach)
        for state in waiting:
            self._take(state)

    def _suffer(self, stream: StateSubscription, breach: Breach) -> None:
        """A verdict over states that are not as they were asked for would be false."""
        if stream is not self._current or self._pause:
            return
        if self._next:
            self._switch(gap=True)
        else:
            self._rest(breach)

    def _rest(self, breach: Breach) -> None:
        self._pause = Pause(self._wall_time(), breach)
        self._node.get_logger().warning(
            f"the group '{self.name}' takes no more states: {breach.message}"
        )

    def _take(self, state: State) -> None:
        """Progresses a state of the current stream, unless there is a reason not to."""
        if self._pause:
            return
        if self._catches_up and self._latest is not None and state.valid_time <= self._latest:
            self._skipped += 1
            return
        if self._catches_up:
            self._node.get_logger().info(
                f"the group '{self.name}' goes on with other states, of which {self._skipped} were "
                'skipped: it has come further than they'
            )
            self._catches_up, self._skipped = False, 0
        if state.lost and self._latest is not None:
            self._miss(state.lost, Gap(self._latest, state.valid_time))
        self._latest = state.valid_time
        if self.group.undecided:
            self._progress(state)

    def _progress(self, state: State) -> None:
        self._states += 1
        try:
            fields = sample_fields(state.message)
        except DyKnowError as error:
            failure = ReasoningError(error.message, error.code)
            self.publish(self.group.fail(failure, state.valid_time))
            return
        self.publish(self.group.progress(state.valid_time, fields))

    def _miss(self, why: str, gap: Gap) -> None:
        """Goes on over states that did not all come: no verdict depends on the others."""
        self.group.gap()
        self._events.append(f'{why}: states may be missing {gap}')
        self._node.get_logger().warning(f"the group '{self.name}': {self._events[-1]}")

    def _message(self, result: FormulaResult) -> Any:
        message = FormulaResultMessage(
            formula_group_id=self._id,
            formula_id=result.formula_id,
            formula_name=result.name,
            verdict=int(result.verdict),
            explanation=result.explanation,
        )
        message.header.stamp = self._node.get_clock().now().to_msg()
        if result.decided_at is not None:
            message.decided_at = nanoseconds_to_time(result.decided_at)
        if result.error is not None:
            fill_exit_status(message.exit_status, result.error)
        return message
