"""Formula groups: formulas that are evaluated over the same states (VI-A.6)."""

from __future__ import annotations

from typing import TYPE_CHECKING

from dyknow_coordinator.evaluation import EvaluationPhase
from dyknow_coordinator.ros.candidates import find_candidates
from dyknow_coordinator.ros.states import States
from dyknow_stream_processing import DyKnowError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from dyknow_coordinator.ground import Ground
    from dyknow_coordinator.ros.facilities import Facilities
    from dyknow_coordinator.ros.formula_evaluation import FormulaEvaluation


class FormulaGroup:
    """The formulas of a group of the reasoning engine, and their states.

    Args:
        group_id: at the reasoning engine.
        name: of the group, and of the stream of states that it listens to already.
        ground: what its formulas are evaluated over.
    """

    def __init__(self, facilities: Facilities, group_id: int, name: str, ground: Ground) -> None:
        self.group_id = group_id
        self.states = States(facilities, group_id, name, ground, self)
        self._facilities = facilities
        self._phase = EvaluationPhase.GROUNDING
        self._members: dict[int, FormulaEvaluation] = {}
        self._joining = 0
        self._failure: DyKnowError | None = None

    @property
    def has_ended(self) -> bool:
        """Whether its last formula has left."""
        return self._phase is EvaluationPhase.ENDED

    def suits(self, ground: Ground) -> bool:
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

    async def begin(self, evaluation: FormulaEvaluation, formula_id: int) -> None:
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

    async def join(self, evaluation: FormulaEvaluation, formula: str) -> None:
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

    def leave(self, evaluation: FormulaEvaluation) -> None:
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

    def _all(self) -> Iterator[FormulaEvaluation]:
        yield from list(self._members.values())

    def _claim(self, evaluation: FormulaEvaluation, formula_id: int) -> None:
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


class FormulaGroups:
    """All groups of the coordinator."""

    def __init__(self, facilities: Facilities) -> None:
        self._facilities = facilities
        self._groups: list[FormulaGroup] = []

    def running(self) -> list[FormulaGroup]:
        """Those that have not ended."""
        self._groups = [group for group in self._groups if not group.has_ended]
        return list(self._groups)

    def suitable(self, ground: Ground) -> FormulaGroup | None:
        """A group over whose states a formula can be evaluated."""
        return next((group for group in self.running() if group.suits(ground)), None)

    def create(self, group_id: int, name: str, ground: Ground) -> FormulaGroup:
        """A new group.

        Raises:
            CoordinationError: NOT_FOUND, naming the features that no stream carries.
        """
        group = FormulaGroup(self._facilities, group_id, name, ground)
        self._groups.append(group)
        return group
