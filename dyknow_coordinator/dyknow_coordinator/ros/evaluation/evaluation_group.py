"""Formula groups: formulas that are evaluated over the same states (VI-A.6)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Protocol

from rclpy.task import Future

from dyknow_common import DyKnowError
from dyknow_coordinator.evaluation.evaluation import EvaluationPhase
from dyknow_coordinator.grounding.ground import GroundedFormula
from dyknow_coordinator.ros.context import CoordinatorContext
from dyknow_coordinator.ros.evaluation.candidates import find_candidates
from dyknow_coordinator.ros.evaluation.results import ResultListener
from dyknow_coordinator.ros.evaluation.state_supervisor import StateObserver, StateSupervisor


class GroupMember(StateObserver, ResultListener, Protocol):
    """The evaluation of one formula, as its group sees it."""

    name: str
    """The name of the formula at the reasoning engine."""

    outcome: Future
    """Done when the evaluation has ended."""


class EvaluationGroup:
    """The formulas of a group of the reasoning engine, and their states.

    Args:
        group_id: at the reasoning engine.
        name: of the group, and of the stream of states that it listens to already.
        ground: what its formulas are evaluated over.
    """

    def __init__(
        self, facilities: CoordinatorContext, group_id: int, name: str, ground: GroundedFormula
    ) -> None:
        self.group_id = group_id
        self.states = StateSupervisor(facilities, group_id, name, ground, self)
        self._facilities = facilities
        self._phase = EvaluationPhase.GROUNDING
        self._members: dict[int, GroupMember] = {}
        self._joining = 0
        self._failure: DyKnowError | None = None

    @property
    def has_ended(self) -> bool:
        """Whether its last formula has left."""
        return self._phase is EvaluationPhase.ENDED

    def suits(self, ground: GroundedFormula) -> bool:
        """Whether a formula can be evaluated over its states."""
        own = self.states.ground
        return (
            not self.has_ended
            and self._failure is None
            and ground.constraints == own.constraints
            and ground.domains.items() <= own.domains.items()
            and sorted(ground.features) == sorted(own.features)
            and self.states.suits(ground.candidates)
        )

    async def begin(self, evaluation: GroupMember, formula_id: int) -> None:
        """Has the states made for the first formula, which is in the group already.

        Raises:
            DyKnowError: when they cannot be made; then its formulas, too, are told.
        """
        self._claim(evaluation, formula_id)
        try:
            await self.states.begin()
        except DyKnowError as error:
            self.fail(error)
            raise

    async def join(self, evaluation: GroupMember, formula: str) -> None:
        """Adds another formula; it begins with the next state.

        Raises:
            DyKnowError: when it cannot be added.
        """
        self._joining += 1
        try:
            formula_id, _ = await self._facilities.clients.add_formula(
                self.group_id, evaluation.name, formula
            )
            if self._failure is not None:
                raise self._failure
            if evaluation.outcome.done():
                # It has left already.
                self._facilities.node.spawn(self._remove, formula_id)
                return
            self._claim(evaluation, formula_id)
        finally:
            self._joining -= 1
            self._end_if_empty()

    def leave(self, evaluation: GroupMember) -> None:
        """Goes on without a formula; ends with the last one."""
        for formula_id, member in list(self._members.items()):
            if member is evaluation:
                del self._members[formula_id]
                self._facilities.results.release(self.group_id, formula_id)
                if self._members or self._joining:
                    self._facilities.node.spawn(self._remove, formula_id)
        self._end_if_empty()

    async def look_for_streams(self) -> None:
        """Looks which streams carry its features now."""
        ground = self.states.ground
        try:
            candidates = await find_candidates(self._facilities, ground.symbols, ground.grounding)
        except DyKnowError as error:
            # Those that it has are good until somebody says otherwise.
            self._facilities.node.get_logger().info(f'{self.states.stream}: {error}')
            return
        if not self.has_ended:
            self.states.take(candidates)

    def note_phase(self, phase: EvaluationPhase) -> None:
        """The states flow now, or are interrupted."""
        if not self.has_ended:
            self._phase = phase
        for member in self._all():
            member.note_phase(phase)

    def tell(self, event: str) -> None:
        """Something has happened to the states."""
        for member in self._all():
            member.tell(event)

    def fail(self, error: DyKnowError) -> None:
        """There can be no more states."""
        self._failure = error
        for member in self._all():
            member.fail(error)

    def _all(self) -> Iterator[GroupMember]:
        yield from list(self._members.values())

    def _claim(self, evaluation: GroupMember, formula_id: int) -> None:
        self._members[formula_id] = evaluation
        evaluation.note_phase(self._phase)
        self._facilities.results.claim(self.group_id, formula_id, evaluation)

    def _end_if_empty(self) -> None:
        if not (self._members or self._joining or self.has_ended):
            self._phase = EvaluationPhase.ENDED
            self.states.end()
            self._facilities.disposal.end_group(self.group_id)

    async def _remove(self, formula_id: int) -> None:
        try:
            await self._facilities.clients.remove_formula(self.group_id, formula_id)
        except DyKnowError as error:
            # The group may have ended meanwhile.
            self._facilities.node.get_logger().info(str(error))


class EvaluationGroups:
    """All groups of the coordinator."""

    def __init__(self, facilities: CoordinatorContext) -> None:
        self._facilities = facilities
        self._groups: list[EvaluationGroup] = []

    def running(self) -> list[EvaluationGroup]:
        """Those that have not ended."""
        self._groups = [group for group in self._groups if not group.has_ended]
        return list(self._groups)

    def suitable(self, ground: GroundedFormula) -> EvaluationGroup | None:
        """A group over whose states a formula can be evaluated."""
        return next((group for group in self.running() if group.suits(ground)), None)

    def create(self, group_id: int, name: str, ground: GroundedFormula) -> EvaluationGroup:
        """A new group.

        Raises:
            CoordinationError: NOT_FOUND, naming the features that no stream carries.
        """
        group = EvaluationGroup(self._facilities, group_id, name, ground)
        self._groups.append(group)
        return group
