"""Services that the coordinator calls, as awaitable functions on plain data."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Any, Final

from dyknow_interfaces.msg import Domain, StreamSpec, SymbolGrounding, UnknownFeature
from dyknow_interfaces.srv import (
    ConceptGetInstances,
    FindAllMatchingStreams,
    FormulaGroupAddFormula,
    FormulaGroupCreate,
    FormulaGroupDestroy,
    FormulaGroupEvaluate,
    FormulaGroupExtractSymbols,
    FormulaGroupRemoveFormula,
    OntologyQuery,
    PushDown,
    StreamCreateFromSpec,
    StreamDestroy,
    StreamGetTopic,
)
from rclpy.task import Future

from dyknow_common import DyKnowError, ExitCode, StreamConstraints, Symbol
from dyknow_common.ros import (
    LONG_TIMEOUT_S,
    Background,
    DyKnowNode,
    RemoteNode,
    constraints_to_message,
    from_message,
    identities_to_message,
    nanoseconds_to_duration,
    nanoseconds_to_time,
)
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import EvaluationRequest
from dyknow_stream_processing import LONG_TEXT, in_namespace

_SERVICES: Final = {
    'stream_manager': (StreamCreateFromSpec, StreamDestroy, StreamGetTopic),
    'ontology_manager': (ConceptGetInstances, OntologyQuery),
    'semantic_matching_engine': (FindAllMatchingStreams,),
    'stream_reasoning_engine': (
        FormulaGroupAddFormula,
        FormulaGroupCreate,
        FormulaGroupDestroy,
        FormulaGroupEvaluate,
        FormulaGroupExtractSymbols,
        FormulaGroupRemoveFormula,
    ),
}

_ALL_KNOWN: Final[Mapping[str, tuple[float, float]]] = {}

_MOST_QUERIES: Final = 4
"""The queries of the ontology that are sent at a time."""

_MOST_SOLUTIONS: Final = 1000
"""Queries whose solutions are kept."""

_PLACED_ERROR: Final = re.compile(
    r'stream specification:\d+:\d+: (?P<reason>[^\n]*)\n.*', re.DOTALL
)


async def ontology_solutions(ontology: RemoteNode, sparql: str) -> list[tuple[str, ...]]:
    """Return the solutions of a query, given the ontology manager.

    Raises:
        DyKnowError: if it refuses the query, or does not answer.
    """
    response = await ontology.call(OntologyQuery, sparql=sparql)
    values = iter(response.values)
    return list(zip(*[values] * len(response.variables), strict=True))


class ServiceClients:
    """Clients of the nodes that the coordinator orchestrates."""

    def __init__(self, node: DyKnowNode, background: Background) -> None:
        self._node, self._background = node, background
        self._waiting: dict[str, Future] = {}
        self._solutions: dict[str, list[tuple[str, ...]]] = {}
        self._solved_for: dict[str, str] = {}
        self._senders = 0
        names = {
            role: node.parameter(role, role, f'Name of the {role.replace("_", " ")} node.')
            for role in (*_SERVICES, 'stream_semantics_manager')
        }
        self.nodes = tuple(
            RemoteNode(node, names[role], timeout_s=LONG_TIMEOUT_S, services=services)
            for role, services in _SERVICES.items()
        )
        (
            self.stream_manager,
            self.ontology_manager,
            self.semantic_matching_engine,
            self.stream_reasoning_engine,
        ) = self.nodes
        self._namespace = node.get_namespace()
        self.streams_namespace = node.resolve_service_name(self.stream_manager.name).rpartition(
            '/'
        )[0]
        """The namespace of the stream manager, whose relative topics are in it."""
        federation = node.parameter('federation', 'federation', 'Name of the federation node.')
        self.federation = RemoteNode(
            node, federation, timeout_s=LONG_TIMEOUT_S, services=(PushDown,)
        )
        """It joins this host with others; most hosts have none."""
        semantics_manager = RemoteNode(node, names['stream_semantics_manager'])
        self.needed_nodes = (*self.nodes, semantics_manager)
        """The nodes in `nodes`, and the nodes that they need in turn; without the engines."""
        self.streams_topic = f'{names["stream_manager"]}/streams'
        self.version_topics = tuple(
            f'{names[role]}/version' for role in ('ontology_manager', 'stream_semantics_manager')
        )

    async def create_group(self, name: str) -> int:
        """Create a formula group; return its id."""
        response = await self.stream_reasoning_engine.call(
            FormulaGroupCreate, formula_group_name=name
        )
        return int(response.formula_group_id)

    async def add_formula(
        self, group_id: int, name: str, formula: str, request: EvaluationRequest
    ) -> tuple[int, str]:
        """Add a formula to a group, as it was requested; return its id and its canonical text."""
        response = await self._call_group(
            FormulaGroupAddFormula,
            group_id,
            formula_name=name,
            formula=formula,
            margin=request.margin,
            every_state=request.every_state,
            since=nanoseconds_to_time(request.since),
        )
        return int(response.formula_id), str(response.canonical_formula)

    async def symbols(self, group_id: int) -> tuple[Symbol, ...]:
        """Return the symbols of a group; with ground features once its domains are known."""
        response = await self._call_group(FormulaGroupExtractSymbols, group_id)
        return tuple(from_message(Symbol, each) for each in response.symbols)

    async def domains(self, sorts: Iterable[str]) -> dict[str, tuple[str, ...]]:
        """Return the objects of each sort."""
        call = partial(self.ontology_manager.call, ConceptGetInstances)
        return {sort: tuple((await call(concept_name=sort)).instances) for sort in sorts}

    async def query(self, sparql: str) -> list[tuple[str, ...]]:
        """Return the solutions of a query of the ontology.

        A few queries are sent at a time, so that many formulas at once do not fill the queue of the
        ontology manager. Equal ones that wait are sent once, and solutions are kept until the
        ontology manager reports a change, in its status before it answers who changed it.
        """
        status = dict(self.ontology_manager.status) if self.ontology_manager.alive else {}
        if status != self._solved_for or len(self._solutions) >= _MOST_SOLUTIONS:
            self._solutions, self._solved_for = {}, status
        if sparql in self._solutions:
            return self._solutions[sparql]
        kept = self._solutions
        solutions = self._waiting.get(sparql)
        if solutions is None:
            solutions = self._waiting[sparql] = Future()
            if self._senders < _MOST_QUERIES:
                self._senders += 1
                self._node.spawn(self._send_queries)
        found: list[tuple[str, ...]] = await solutions
        if status:
            kept[sparql] = found
        return found

    async def _send_queries(self) -> None:
        while self._waiting:
            sparql = next(iter(self._waiting))
            solutions = self._waiting.pop(sparql)
            try:
                solutions.set_result(await ontology_solutions(self.ontology_manager, sparql))
            except Exception as error:  # noqa: BLE001 - formulas wait for it
                solutions.set_exception(error)
        self._senders -= 1

    async def matching_streams(self, concept: str) -> tuple[str, ...]:
        """Return the specifications of the streams that match a concept, best first."""
        response = await self.semantic_matching_engine.call(FindAllMatchingStreams, concept=concept)
        return tuple(response.stream_specifications)

    async def evaluate_group(
        self,
        group_id: int,
        domains: Mapping[str, Sequence[str]],
        state_stream: str,
        result_topic: str,
        *,
        unknown: Mapping[str, tuple[float, float]] = _ALL_KNOWN,
        gap: bool = False,
        doubtful_from: int = 0,
    ) -> None:
        """Start the evaluation of a group, or switch it to another topic of states.

        At its start, `unknown` has the features that may be unknown, with their bounds.
        If there is a gap, states may be missing between the two topics; if the other one is the
        standby, states from the valid time `doubtful_from` (in nanoseconds) on may be wrong.
        """
        await self._call_group(
            FormulaGroupEvaluate,
            group_id,
            domains=_domains_to_message(domains),
            unknown=[
                UnknownFeature(name=name, lower=lower, upper=upper)
                for name, (lower, upper) in unknown.items()
            ],
            state_stream=state_stream,
            result_topic=result_topic,
            gap=gap,
            doubtful_from=nanoseconds_to_time(doubtful_from),
        )

    async def keep_states(self, group_id: int, topic: str) -> None:
        """Have a group under evaluation keep the states of a stream on standby; '': of none."""
        await self._call_group(FormulaGroupEvaluate, group_id, standby=topic)

    async def create_stream(
        self,
        name: str,
        specification: str,
        constraints: StreamConstraints,
        sources: Mapping[str, int],
    ) -> tuple[str, str]:
        """Create a stream; return its topic and the topic of its violations.

        On the topics of `sources`, it is only made from streams with the given ids. Its relative
        topics are in the namespace of the coordinator, whatever the manager's namespace is.
        """
        move = partial(in_namespace, specification, self._namespace, self.streams_namespace)
        spec = StreamSpec(
            name=name,
            specification=await self._background.run(move, is_long=len(specification) > LONG_TEXT),
            constraints=constraints_to_message(constraints),
        )
        try:
            response = await self.stream_manager.call(
                StreamCreateFromSpec, spec=spec, sources=identities_to_message(sources)
            )
        except DyKnowError as error:
            # Nobody has written the text, so its places say nothing.
            found = _PLACED_ERROR.fullmatch(error.message)
            raise DyKnowError(found['reason'], error.code) if found else error from None
        return str(response.stream_topic), str(response.stream_constraint_violation_topic)

    async def check_stream(self, name: str) -> None:
        """Check that there is a stream; the error of the stream manager lists the known ones."""
        await self.stream_manager.call(StreamGetTopic, stream_name=name)

    async def pushed_down(
        self,
        formula: str,
        domains: Mapping[str, Sequence[str]],
        groundings: Sequence[SymbolGrounding],
        sample_period: int | None,
    ) -> tuple[str, tuple[str, ...]]:
        """Return what peers leave of a formula, and what they evaluate.

        All of it is left, as an empty text, if these cannot evaluate a part.
        """
        try:
            response = await self.federation.call(
                PushDown,
                formula=formula,
                domains=_domains_to_message(domains),
                groundings=groundings,
                sample_period=list(map(nanoseconds_to_duration, filter(None, [sample_period]))),
            )
        except DyKnowError as error:
            self._node.get_logger().info(f'no part is evaluated by peers: {error}')
            return '', ()
        return str(response.formula), tuple(response.parts)

    async def destroy_stream(self, name: str) -> None:
        """Destroy a stream."""
        await self.stream_manager.call(StreamDestroy, stream_name=name)

    async def remove_formula(self, group_id: int, formula_id: int, until: int = 0) -> None:
        """Remove a formula from a group, once it has its states until a valid time in ns."""
        await self._call_group(
            FormulaGroupRemoveFormula,
            group_id,
            formula_id=formula_id,
            until=nanoseconds_to_time(until),
        )

    async def destroy_group(self, group_id: int) -> None:
        """Destroy a formula group."""
        await self.stream_reasoning_engine.call(FormulaGroupDestroy, formula_group_id=group_id)

    async def _call_group(self, service_type: Any, group_id: int, **fields: Any) -> Any:
        """Call a service for a formula group.

        Raises:
            DyKnowError: UNAVAILABLE if the engine no longer has the group: it was restarted, or had
                no request for longer than its `orphan_limit`.
        """
        try:
            return await self.stream_reasoning_engine.call(
                service_type, formula_group_id=group_id, **fields
            )
        except DyKnowError as error:
            if error.code is not ExitCode.NOT_FOUND:
                raise
            text = (
                f'node {self.stream_reasoning_engine.name} was restarted, or destroyed the formula '
                f'group as nobody seemed to use it: {error}'
            )
            raise CoordinationError(text, ExitCode.UNAVAILABLE) from None


def _domains_to_message(domains: Mapping[str, Sequence[str]]) -> list[Domain]:
    return [Domain(sort=sort, objects=list(found)) for sort, found in domains.items()]
