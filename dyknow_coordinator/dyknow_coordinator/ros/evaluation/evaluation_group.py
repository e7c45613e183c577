"""Formula groups: formulas that are evaluated over the same states (VI-A.6).

Example: two clients request a formula each, over the same feature of the same vehicle.

    client A: always Power[uav1] < 150       client B: eventually Power[uav1] > 90
    group 7 is created with A's formula
    stream states_1 is created               group 8 is created with B's formula, to find its
    states s1, s2: A is progressed           symbols, domains and candidates (the same as A's)
    B's formula is added to group 7          group 8 is destroyed
    states s3, s4: A and B are progressed
    A is decided: its formula is removed
    states s5, s6: B is progressed
    B is decided: group 7 and stream states_1 are destroyed

A formula may join a group with the same constraints and ground features, and at least its domains,
if it would choose the same streams now.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import Final, Protocol

from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.task import Future

from dyknow_common import DyKnowError, Symbol
from dyknow_coordinator.evaluation import EvaluationPhase, EvaluationRequest
from dyknow_coordinator.grounding.candidate_search import CandidateSearch
from dyknow_coordinator.grounding.feature_sources import (
    Candidates,
    FeatureSource,
    Grounding,
    parse_sources,
)
from dyknow_coordinator.grounding.known_streams import KnownStreams
from dyknow_coordinator.grounding.state_specification import FormulaInputs
from dyknow_coordinator.ros.context import CoordinatorContext
from dyknow_coordinator.ros.evaluation.state_supervisor import StateObserver, StateSupervisor
from dyknow_coordinator.ros.results import ResultListener

_MAX_TITLES: Final = 3
_MANY: Final = 50
"""Specifications that take tens of milliseconds to parse."""


class GroupMember(StateObserver, ResultListener, Protocol):
    """The evaluation of one formula, as its group uses it."""

    name: str
    """The name of the formula at the reasoning engine."""

    request: EvaluationRequest
    """The formula and the options of its client."""

    outcome: Future
    """Done when the evaluation has ended."""

    @property
    def title(self) -> str:
        """The name of the formula for people."""


class EvaluationGroup:
    """The formulas of a group of the reasoning engine, and their states.

    Args:
        group_id: at the reasoning engine.
        name: the name of the group, and of the state stream that the engine has subscribed to.
    """

    def __init__(
        self, context: CoordinatorContext, group_id: int, name: str, inputs: FormulaInputs
    ) -> None:
        self.group_id = group_id
        self.states = StateSupervisor(context, group_id, name, inputs, self)
        self._context = context
        self._phase = EvaluationPhase.GROUNDING
        self.waits_for = ''
        """Why no state comes; empty if the phase is not WAITING."""
        self._members: dict[int, GroupMember] = {}
        # The formulas that the engine removes, with the valid times until which they get states.
        self._removed: dict[int, int] = {}
        self._joining = 0
        self._error: DyKnowError | None = None

    @property
    def has_ended(self) -> bool:
        """True if its last formula has left."""
        return self._phase is EvaluationPhase.ENDED

    def accepts(self, inputs: FormulaInputs) -> bool:
        """Return True if a formula with the given inputs can join."""
        own = self.states.inputs
        return (
            not self.has_ended
            and self._error is None
            and inputs.constraints == own.constraints
            and inputs.domains.items() <= own.domains.items()
            and inputs.unknown == own.unknown
            and sorted(inputs.features) == sorted(own.features)
            and self.states.would_choose_from(inputs.candidates)
        )

    async def start(self, member: GroupMember, formula_id: int) -> None:
        """Create the state stream for the first formula, which the engine's group has already.

        Raises:
            DyKnowError: if the stream cannot be created; then the formulas fail, too.
        """
        self._add_member(member, formula_id)
        try:
            await self.states.start()
        except DyKnowError as error:
            self.fail(error)
            raise

    async def join(self, member: GroupMember, formula: str) -> None:
        """Add another formula; its first state is the next one.

        Raises:
            DyKnowError: if it cannot be added.
        """
        self._joining += 1
        try:
            formula_id, _ = await self._context.clients.add_formula(
                self.group_id, member.name, formula, member.request
            )
            if self._error is not None:
                raise self._error
            if member.outcome.done():
                # The evaluation has ended meanwhile.
                self._context.node.spawn(self._remove, formula_id)
                return
            self._add_member(member, formula_id)
        finally:
            self._joining -= 1
            self._end_if_empty()

    def remove(self, leaving: GroupMember, until: int = 0) -> bool:
        """Have the engine remove a formula after a last report; return False if it has not got it.

        The formula is a member until it leaves.

        Args:
            leaving: the formula.
            until: the valid time in nanoseconds until which it gets states; 0: no more states.
        """
        members = [each for each, member in self._members.items() if member is leaving]
        found = [each for each in members if self._removed.get(each, until + 1) > until]
        self.note_removed(leaving, until)
        for formula_id in found:
            self._context.node.spawn(self._remove, formula_id, until)
        return bool(found)

    def note_removed(self, leaving: GroupMember, until: int = 0) -> None:
        """Note that the engine removes a formula, or has removed it."""
        members = [each for each, member in self._members.items() if member is leaving]
        self._removed |= {each: min(self._removed.get(each, until), until) for each in members}

    def leave(self, leaving: GroupMember) -> None:
        """Remove a formula, unless that has happened; end with the last one."""
        for formula_id, member in list(self._members.items()):
            if member is leaving:
                if len(self._members) > 1 or self._joining:
                    self.remove(leaving)
                del self._members[formula_id]
                self._context.results.unregister(self.group_id, formula_id)
        self._end_if_empty()

    async def update_candidates(self) -> None:
        """Search again for the streams that carry its features."""
        inputs = self.states.inputs
        try:
            candidates = await find_candidates(self._context, inputs.symbols, inputs.grounding)
        except DyKnowError as error:
            # The streams in use are kept.
            self._context.node.get_logger().info(f'{self.states.stream.name}: {error}')
            return
        if not self.has_ended:
            self.states.update_candidates(candidates)

    @property
    def titles(self) -> str:
        """The names of its formulas, for people; only the first ones of many."""
        titles = list(dict.fromkeys(member.title for member in self._members.values()))
        more = ', ...' if len(titles) > _MAX_TITLES else ''
        return f'{", ".join(titles[:_MAX_TITLES])}{more}'

    @property
    def logger(self) -> RcutilsLogger:
        """The logger of what people are told of its states."""
        is_followed = all(member.request.is_followed for member in self._members.values())
        return self._context.outcome_logger(is_followed=is_followed)

    def set_waiting(self, reason: str) -> None:
        """Set that no state comes, and why, or that states come again if the reason is empty."""
        is_evaluated = self._phase in (EvaluationPhase.RUNNING, EvaluationPhase.WAITING)
        if is_evaluated and reason != self.waits_for:
            phase = EvaluationPhase.WAITING if reason else EvaluationPhase.RUNNING
            self.set_phase(phase, reason)

    def set_phase(self, phase: EvaluationPhase, waits_for: str = '') -> None:
        """Set the phase of all formulas, and if it is WAITING, why no state comes."""
        self.waits_for = waits_for
        if not self.has_ended:
            self._phase = phase
        for member in list(self._members.values()):
            member.set_phase(phase)

    def add_event(self, event: str) -> None:
        """Record an event in the histories of all formulas."""
        for member in list(self._members.values()):
            member.add_event(event)

    def fail(self, error: DyKnowError) -> None:
        """End the evaluation of all formulas with an error."""
        self._error = error
        for member in list(self._members.values()):
            member.fail(error)

    def _add_member(self, member: GroupMember, formula_id: int) -> None:
        self._members[formula_id] = member
        member.set_phase(self._phase)
        self._context.results.register(self.group_id, formula_id, member)

    def _end_if_empty(self) -> None:
        if not (self._members or self._joining or self.has_ended):
            self._phase = EvaluationPhase.ENDED
            self.states.end()
            self._context.cleanup.destroy_group(self.group_id)

    async def _remove(self, formula_id: int, until: int = 0) -> None:
        try:
            await self._context.clients.remove_formula(self.group_id, formula_id, until)
        except DyKnowError as error:
            if not self.has_ended:
                self._context.node.get_logger().info(str(error))


class EvaluationGroups:
    """All groups of the coordinator."""

    def __init__(self, context: CoordinatorContext) -> None:
        self._context = context
        self._groups: list[EvaluationGroup] = []

    def running(self) -> list[EvaluationGroup]:
        """Return the groups that have not ended."""
        self._groups = [group for group in self._groups if not group.has_ended]
        return list(self._groups)

    def find(self, inputs: FormulaInputs) -> EvaluationGroup | None:
        """Return a group that a formula with the given inputs can join."""
        return next((group for group in self.running() if group.accepts(inputs)), None)

    def create(self, group_id: int, name: str, inputs: FormulaInputs) -> EvaluationGroup:
        """Create a group.

        Raises:
            CoordinationError: NOT_FOUND, naming the features that no stream carries.
        """
        group = EvaluationGroup(self._context, group_id, name, inputs)
        self._groups.append(group)
        return group


async def find_candidates(
    context: CoordinatorContext, symbols: Sequence[Symbol], grounding: Grounding
) -> Candidates:
    """Return the sources of all features among symbols.

    Raises:
        DyKnowError: if a feature is invalid, or a node that is needed is unavailable.
    """

    async def matching_sources(concept: str) -> tuple[FeatureSource, ...]:
        texts = await context.clients.matching_streams(concept)
        return await context.background.run(partial(_parsed, texts), is_long=len(texts) > _MANY)

    async def stream_fields(name: str) -> tuple[str, ...]:
        await context.clients.check_stream(name)
        await context.streams.wait_for(name)
        return context.streams.fields(name)

    return await CandidateSearch(matching_sources, stream_fields).find(symbols, grounding)


def _parsed(texts: Sequence[str]) -> tuple[FeatureSource, ...]:
    sources = parse_sources(texts)
    for source in sources:
        KnownStreams.parse(source)
    return sources
