"""The evaluation of one formula, from the question to the answer: section VII of the paper.

The steps of that section are numbered in the code; two of them change places. The reasoning engine
has to know the domains (7) before it can tell which ground features a state must hold, so that
step comes before the state stream is put together (6). And it has to listen before the state
stream begins (9), or the first states would be missed.
"""

from __future__ import annotations

import traceback
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from rclpy.task import Future

from dyknow_common import DyKnowError, ExitCode, Verdict
from dyknow_common.ros import time_to_nanoseconds
from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation.evaluation import Evaluation, EvaluationOutcome, EvaluationPhase
from dyknow_coordinator.evaluation.history import History
from dyknow_coordinator.evaluation.request import EvaluationRequest
from dyknow_coordinator.grounding.ground import GroundedFormula, SymbolGrounding, symbol_groundings
from dyknow_coordinator.grounding.grounding import check_grounding, features, sorts
from dyknow_coordinator.reporting.evaluation_status import EvaluationStatus
from dyknow_coordinator.ros.context import CoordinatorContext
from dyknow_coordinator.ros.evaluation.candidates import find_candidates
from dyknow_coordinator.ros.evaluation.evaluation_group import EvaluationGroup, EvaluationGroups


@dataclass(frozen=True, slots=True)
class Asked:
    """A formula in a group of its own, and what it needs.

    Args:
        name: of the group, and of the stream of states that it listens to.
        group_id: at the reasoning engine.
        formula_id: in the group.
        ground: what it is to be evaluated over.
    """

    name: str
    group_id: int
    formula_id: int
    ground: GroundedFormula


class FormulaEvaluation:
    """Grounds a formula, has it evaluated, and cleans up behind it.

    Args:
        question: what is asked.
        on_change: is called when its status has changed.
    """

    def __init__(
        self,
        facilities: CoordinatorContext,
        groups: EvaluationGroups,
        question: EvaluationRequest,
        on_change: Callable[[], None],
    ) -> None:
        self.name = next(facilities.names)
        self.question = question
        self.canonical_formula = ''
        self.outcome: Future = Future()
        self.on_progress: Callable[[], None] = lambda: None
        self.history = History()
        self._facilities = facilities
        self._groups = groups
        self._on_change = on_change
        self._evaluation = Evaluation(self._end)
        self._started = facilities.node.now()
        self._group: EvaluationGroup | None = None
        self._is_asking = False
        self._progress: Any = None
        self._groundings: tuple[SymbolGrounding, ...] = ()

    @property
    def presumably_false(self) -> bool:
        """Whether it would be false if no further state came."""
        return self._progress is not None and bool(self._progress.presumably_false)

    @property
    def progress(self) -> Any:
        """The latest report of the reasoning engine; None before the first."""
        return self._progress

    @property
    def groundings(self) -> tuple[SymbolGrounding, ...]:
        """How each of its ground features found its stream; those that it ended with."""
        if self._group is None:
            return self._groundings
        return symbol_groundings(self._group.states.ground.candidates, self._group.states.chosen)

    async def run(self) -> None:
        """Takes the steps, then waits for the outcome and leaves nothing behind; never raises."""
        expiry = self._expire_in(self.question.timeout)
        try:
            await self._enter(await self._ask())
            await self.outcome
        except DyKnowError as error:
            self._evaluation.fail(error)
        except Exception as error:  # noqa: BLE001 - the caller must get an answer
            text = ''.join(traceback.format_exception(error))
            self._facilities.node.get_logger().error(f'fault in {self.name}:\n{text}')
            self._evaluation.fail(
                CoordinationError(f'fault in DyKnow: {error!r}', ExitCode.INTERNAL_ERROR)
            )
        if expiry is not None:
            expiry.cancel()
        self._leave()

    async def look_for_objects(self) -> None:
        """Begins anew where the sorts of the formula have other objects than they had."""
        group = self._group
        if group is None or self._evaluation.has_ended or self._is_asking:
            return
        domains = group.states.ground.domains
        try:
            if all([await self._domain(sort) == found for sort, found in domains.items()]):
                return
            self._is_asking = True
            asked = await self._ask()
        except DyKnowError as error:
            self.tell(f'it cannot begin anew for other objects yet: {error}')
            return
        finally:
            self._is_asking = False
        if self.outcome.done():
            self._facilities.disposal.end_group(asked.group_id)
            return
        self._leave()
        self.tell(f'it begins anew, for {_listed(asked.ground.domains)}')
        self._progress = None
        try:
            await self._enter(asked)
        except DyKnowError as error:
            self._evaluation.fail(error)

    def cancel(self, why: str = 'cancelled by the caller') -> None:
        """Ends the evaluation without a verdict."""
        self._evaluation.cancel(why)

    def lose(self, what: str) -> None:
        """Ends the evaluation, since a node that it needs is gone."""
        self._evaluation.lose(what)

    def fail(self, error: DyKnowError) -> None:
        """Ends the evaluation with an error."""
        self._evaluation.fail(error)

    def receive(self, result: Any) -> None:
        """Takes the reasoning engine's result for this formula (step 8)."""
        status = result.exit_status
        if status.code != ExitCode.SUCCESS:
            self.fail(CoordinationError(status.message, ExitCode(status.code)))
        else:
            self._evaluation.decide(
                Verdict(result.verdict),
                time_to_nanoseconds(result.decided_at),
                result.explanation,
            )

    def note_progress(self, progress: Any) -> None:
        """Takes a report of the reasoning engine."""
        self._progress = progress
        for event in progress.events:
            self.tell(event)
        self.on_progress()

    def note_phase(self, phase: EvaluationPhase) -> None:
        """The states of its group flow now, or are interrupted."""
        self._evaluation.enter(phase)
        self._on_change()

    def tell(self, event: str) -> None:
        """Notes what has happened to it."""
        self.history.add(event)
        self._facilities.node.get_logger().info(f'{self.name}: {event}')
        self._on_change()

    def status(self) -> EvaluationStatus:
        """What an operator sees of it."""
        outcome: EvaluationOutcome = (
            self.outcome.result() if self.outcome.done() else EvaluationOutcome()
        )
        progress, group, question = self._progress, self._group, self.question
        formula = self.canonical_formula or question.formula
        return EvaluationStatus(
            name=question.name or formula,
            formula=formula,
            phase=self._evaluation.phase,
            started=self._started,
            plan=question.plan,
            action=question.action,
            formula_group_id=group.group_id if group else 0,
            state_stream=group.states.topic if group else '',
            groundings=self.groundings,
            events=self.history.latest,
            states_progressed=progress.states_progressed if progress else 0,
            latest_valid_time=time_to_nanoseconds(progress.latest_valid_time) or None
            if progress
            else None,
            residual_formula=progress.residual_formula if progress else '',
            presumably_false=self.presumably_false,
            verdict=outcome.verdict,
            decided_at=outcome.decided_at,
            explanation=outcome.explanation,
            error=outcome.error,
        )

    async def _ask(self) -> Asked:
        """What the formula needs, found in a formula group of its own."""
        clients, question = self._facilities.clients, self.question
        # Step 1 is the caller's request. Step 2: a formula group with the formula in it.
        name = next(self._facilities.names)
        group_id = await clients.create_group(name)
        try:
            formula_id, self.canonical_formula = await clients.add_formula(
                group_id, name, question.formula
            )
            # Step 3: the symbols of the formula.
            symbols = await clients.symbols(group_id)
            check_grounding(symbols, question.grounding)
            # Step 4: the domain of each sort.
            domains = {sort: await self._domain(sort) for sort in sorts(symbols)}
            # Step 5: the streams that match each feature.
            candidates = await find_candidates(self._facilities, symbols, question.grounding)
            # Step 7: the reasoning engine listens before the first state can come. With the
            # domains fixed, it knows the ground features that each state must hold.
            await clients.evaluate_group(
                group_id,
                domains,
                self._facilities.state_topic(name),
                self._facilities.results.topic,
            )
            ground_features = tuple(map(str, features(await clients.symbols(group_id))))
            candidates.choose(ground_features)
        except BaseException:
            self._facilities.disposal.end_group(group_id)
            raise
        ground = GroundedFormula(
            symbols, question.grounding, ground_features, candidates, domains, question.constraints
        )
        return Asked(name, group_id, formula_id, ground)

    async def _enter(self, asked: Asked) -> None:
        """Has the formula evaluated."""
        # Step 6: one stream of states out of the streams of the ground features. Formulas over
        # the same streams share it, and the group; one over no feature needs no state.
        try:
            group = self._groups.suitable(asked.ground) if asked.ground.features else None
            self._group = group or self._groups.create(asked.group_id, asked.name, asked.ground)
        except DyKnowError:
            self._facilities.disposal.end_group(asked.group_id)
            raise
        if group is not None:
            self._facilities.disposal.end_group(asked.group_id)
            await group.join(self, self.question.formula)
        else:
            # Steps 9 to 11: the stream manager has a stream processing engine make the states.
            await self._group.begin(self, asked.formula_id)
        if self.outcome.done():
            # The answer came, or was not wanted any more, while it began.
            self._leave()
        # Step 12 happens in the reasoning engine; 8 comes to `receive`, 13 to `States`.

    async def _domain(self, sort: str) -> tuple[str, ...]:
        return await self._facilities.clients.instances(sort)

    def _leave(self) -> None:
        if self._group is not None:
            self._groundings, group = self.groundings, self._group
            self._group = None
            group.leave(self)

    def _expire_in(self, seconds: float | None) -> Future | None:
        if seconds is None:
            return None
        expiry = self._facilities.node.deadlines.after(seconds)
        expiry.add_done_callback(lambda _: self._evaluation.expire(seconds))
        return expiry

    def _end(self, outcome: EvaluationOutcome) -> None:
        self.outcome.set_result(outcome)
        self._on_change()


def _listed(domains: Mapping[str, Iterable[str]]) -> str:
    return '; '.join(f'{sort}: {", ".join(found) or "none"}' for sort, found in domains.items())
