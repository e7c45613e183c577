"""Reads the reports of a running system, more of them while a page is open.

A formula may have fifty states a second, and all are read of those that signals are kept of, so
states are taken many at a time, as bytes. A callback for each message, and rclpy's objects for its
fields, take five times as long.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from dyknow_interfaces.msg import EvaluationStatusArray, Sample, StreamStatusArray
from dyknow_interfaces.srv import ListSemanticSpecifications, OntologyQuery
from rclpy.callback_groups import CallbackGroup
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from dyknow_common import DyKnowError
from dyknow_common.ros import (
    LATCHED,
    NO_SUBSCRIPTION_EVENTS,
    STREAM,
    NodeAdapter,
    ros_errors,
    time_to_nanoseconds,
)
from dyknow_coordinator.ros.reporting.evaluation_messages import status_from_message
from dyknow_dashboard.model.board import Board, State
from dyknow_dashboard.model.health import DiagnosedPart
from dyknow_dashboard.ros.nodes_of_system import (
    COORDINATOR,
    FEDERATION,
    ONTOLOGY_MANAGER,
    SEMANTICS_MANAGER,
    STREAM_MANAGER,
    SystemNodes,
)
from dyknow_federation.report import FederationReport
from dyknow_semantics import ALL_TRIPLES, Matcher, bridged
from dyknow_semantics.ros.mirrors import annotations_by_text, faults_of, triples_of
from dyknow_stream_processing.ros import SampleReader, take_waiting
from dyknow_stream_processing.ros.messages.stream_report_messages import report_from_message

PERIOD_S: Final = 1.0

STATE_PERIOD_S: Final = 0.2
"""The time between two looks at the states, of which the middleware keeps up to 1000."""

_MAX_ENTRIES: Final = 100
"""The number of entries of a message of `/diagnostics` that are read."""


class _NeverCalled(CallbackGroup):
    """The group of subscriptions that no executor waits for."""

    def can_execute(self, _entity: Any) -> bool:
        return False

    def beginning_execution(self, _entity: Any) -> bool:
        return False


@dataclass(slots=True)
class _StateTopic:
    subscription: Any
    reader: SampleReader = field(default_factory=SampleReader)


class StateTopics:
    """Subscriptions to topics of states, which a timer reads.

    Args:
        adapter: of the node that reads; its methods are called in the thread of its executor.
        on_states: called with the states that have come, those of a topic in their order.
    """

    def __init__(self, adapter: NodeAdapter, on_states: Callable[[list[State]], None]) -> None:
        self._node = adapter.node
        self._on_states = on_states
        self._group = _NeverCalled()
        self._topics: dict[str, _StateTopic] = {}
        adapter.create_timer(STATE_PERIOD_S, self._read, clock=adapter.wall_clock)

    def read(self, topics: frozenset[str]) -> None:
        """Read these topics from now on, and no others."""
        for topic in self._topics.keys() - topics:
            self._node.destroy_subscription(self._topics.pop(topic).subscription)
        for topic in topics - self._topics.keys():
            # A report may name a topic that cannot exist: there is nothing to show of it.
            with suppress(DyKnowError), ros_errors():
                self._topics[topic] = _StateTopic(
                    self._node.create_subscription(
                        Sample,
                        topic,
                        lambda _: None,
                        STREAM,
                        callback_group=self._group,
                        event_callbacks=NO_SUBSCRIPTION_EVENTS,
                        raw=True,
                    )
                )

    def _read(self) -> None:
        if states := [each for topic in self._topics for each in self._states(topic)]:
            self._on_states(states)

    def _states(self, topic: str) -> Iterator[State]:
        held = self._topics[topic]
        for data, _ in take_waiting(held.subscription):
            # The reasoning engine has reported a state that cannot be used.
            with suppress(DyKnowError):
                yield (topic, *held.reader.read(data))


class SystemReader:
    """Subscriptions to the reports of a system; the board gets what they say.

    The reports on evaluations, and the states of formulas whose signals are kept, are always read:
    their history is shown when a page is opened. All others are read while a page is open. The
    board belongs to another thread, which `deliver` has run what is given to it.

    Args:
        adapter: of the node that reads; its methods are called in the thread of its executor.
        board: what pages show.
        deliver: has the thread of the board call a function.
        on_formulas: called there after each report on evaluations.
    """

    def __init__(
        self,
        adapter: NodeAdapter,
        board: Board,
        deliver: Callable[[Callable[[], None]], None],
        on_formulas: Callable[[], None],
    ) -> None:
        self._adapter = adapter
        self._board = board
        self._deliver = deliver
        self._on_formulas = on_formulas
        self._nodes: SystemNodes | None = None
        self._attended: list[Any] = []
        self._timer: Any = None
        self._states = StateTopics(adapter, lambda found: deliver(partial(board.add_states, found)))
        self._semantics: Any = None
        self._is_reading = False
        self._subscribe(EvaluationStatusArray, f'{COORDINATOR}/evaluations', self._on_evaluations)

    def attend(self, *, is_open: bool, topics: frozenset[str]) -> None:
        """Read what pages need.

        Args:
            is_open: True if a page is open.
            topics: of the states that signals are kept of.
        """
        if is_open and self._nodes is None:
            self._begin()
        elif not is_open and self._nodes is not None:
            self._end()
        self._states.read(topics)

    def _begin(self) -> None:
        self._nodes = SystemNodes(self._adapter)
        self._attended = [
            self._subscribe(StreamStatusArray, f'{STREAM_MANAGER}/streams', self._on_streams),
            self._subscribe(
                DiagnosticArray, '/diagnostics', self._on_diagnostics, QoSProfile(depth=10)
            ),
            self._subscribe(String, f'{FEDERATION}/federation', self._on_federation),
        ]
        self._timer = self._adapter.create_timer(
            PERIOD_S, self._update, clock=self._adapter.wall_clock
        )

    def _end(self) -> None:
        if self._nodes is not None:
            self._nodes.release()
            self._nodes = None
        self._adapter.node.destroy_timer(self._timer)
        for each in self._attended:
            self._adapter.node.destroy_subscription(each)
        self._attended = []

    def _subscribe(
        self, kind: Any, topic: str, callback: Callable[[Any], None], qos: QoSProfile = LATCHED
    ) -> Any:
        return self._adapter.create_subscription(
            kind, topic, callback, qos, event_callbacks=NO_SUBSCRIPTION_EVENTS
        )

    def _on_evaluations(self, message: Any) -> None:
        statuses = [status_from_message(each) for each in message.evaluations]
        now = time_to_nanoseconds(message.stamp)

        def update() -> None:
            self._board.report(statuses, now)
            self._on_formulas()

        self._deliver(update)

    def _on_streams(self, message: Any) -> None:
        reports = [report_from_message(each) for each in message.streams]
        engines = list(message.engines)
        if self._nodes is not None:
            self._nodes.find_engines(engines)
        self._deliver(partial(self._board.streams.update, reports, engines))

    def _on_diagnostics(self, message: Any) -> None:
        parts = [
            DiagnosedPart(each.name, each.level[0], each.message)
            for each in message.status[:_MAX_ENTRIES]
        ]
        self._deliver(partial(self._board.health.diagnose, parts, self._now()))

    def _on_federation(self, message: Any) -> None:
        # Another node may publish there, too: there is nothing to show of it.
        with suppress(ValueError, KeyError, TypeError):
            report = FederationReport.of(json.loads(message.data))
            self._deliver(partial(self._board.peers.update, report))

    def _update(self) -> None:
        """Report the health of nodes, and read the ontology if it has changed."""
        nodes = self._nodes
        if nodes is None:
            return
        nodes.find_reactions()
        health, can_save = list(nodes.health()), nodes.can_save()

        def update() -> None:
            self._board.health.update(health, self._now())
            self._board.can_save = can_save

        self._deliver(update)
        remotes = nodes.remote(ONTOLOGY_MANAGER), nodes.remote(SEMANTICS_MANAGER)
        semantics = [dict(each.status) for each in remotes]
        is_alive = all(each.alive for each in remotes)
        executor = self._adapter.node.executor
        is_stale = semantics != self._semantics and not self._is_reading
        if is_alive and is_stale and executor is not None:
            self._is_reading = True
            executor.create_task(self._read_semantics, nodes, semantics)

    async def _read_semantics(self, nodes: SystemNodes, semantics: Any) -> None:
        concepts = self._board.concepts
        try:
            ontology = await nodes.remote(ONTOLOGY_MANAGER).call(OntologyQuery, sparql=ALL_TRIPLES)
            listed = await nodes.remote(SEMANTICS_MANAGER).call(ListSemanticSpecifications)
            matcher = Matcher(bridged(triples_of(ontology)).known)
            faults = faults_of(listed)
            annotations = annotations_by_text(listed.ssl_statements)
            matcher.set_annotations(annotations, faults)
            texts = {text: faults.get(text, '') for text in annotations}
            self._deliver(partial(concepts.update, matcher, texts))
            self._semantics = semantics
        except Exception as error:  # noqa: BLE001 - it would end the executor
            self._deliver(partial(concepts.fail, str(error)))
        finally:
            self._is_reading = False

    def _now(self) -> int:
        return int(self._adapter.wall_clock.now().nanoseconds)
