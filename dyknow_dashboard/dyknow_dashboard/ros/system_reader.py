"""Reads the reports of a running system, more of them while a page is open."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from typing import Any, Final

from diagnostic_msgs.msg import DiagnosticArray
from dyknow_interfaces.msg import EvaluationStatusArray, StreamStatusArray
from dyknow_interfaces.srv import ListSemanticSpecifications, OntologyQuery
from rclpy.qos import QoSProfile
from std_msgs.msg import String

from dyknow_common.ros import (
    LATCHED,
    NodeAdapter,
    time_to_nanoseconds,
)
from dyknow_coordinator.ros.reporting.evaluation_messages import status_from_message
from dyknow_dashboard.model.board import Board
from dyknow_dashboard.model.health import DiagnosedPart
from dyknow_dashboard.ros.drawn_streams import MapStreams, StateTopics
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
from dyknow_stream_processing.ros.messages.stream_report_messages import report_from_message

PERIOD_S: Final = 1.0

_MAX_ENTRIES: Final = 100
"""The number of entries of a message of `/diagnostics` that are read."""


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
        self._maps = MapStreams(adapter, lambda found: deliver(partial(board.map.add, found)))
        self._semantics: Any = None
        self._is_reading = False
        self._subscribe(EvaluationStatusArray, f'{COORDINATOR}/evaluations', self._on_evaluations)

    def attend(self, *, is_open: bool, topics: frozenset[str], maps: Mapping[str, str]) -> None:
        """Read what pages need.

        Args:
            is_open: True if a page is open.
            topics: the topics of the states that signals are kept of.
            maps: the texts of the streams of maps, by the names of the objects.
        """
        if is_open and self._nodes is None:
            self._begin()
        elif not is_open and self._nodes is not None:
            self._end()
        self._states.read(topics)
        self._maps.read(maps)

    def _begin(self) -> None:
        self._deliver(self._board.forget)
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
        return self._adapter.create_subscription(kind, topic, callback, qos)

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
