"""One evaluation of a formula, by the thirteen steps of the paper's section VII."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from dyknow_interfaces.msg import ConstraintViolation
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.task import Future

from dyknow_coordinator.errors import CoordinationError
from dyknow_coordinator.evaluation import Evaluation, Outcome, Phase, Verdict
from dyknow_coordinator.grounding import (
    Grounding,
    Source,
    Symbol,
    check_grounding,
    choose,
    concept_of,
    features,
    referenced,
    sorts,
    sources,
    state_specification,
)
from dyknow_stream_processing import DyKnowError, ExitCode
from dyknow_stream_processing.ros import (
    VIOLATIONS,
    Lease,
    fill_exit_status,
    nanoseconds_to_time,
    time_to_nanoseconds,
)

if TYPE_CHECKING:
    from dyknow_coordinator.ros.clients import Clients
    from dyknow_stream_processing import StreamConstraints
    from dyknow_stream_processing.ros import DyKnowNode


@dataclass(frozen=True, slots=True)
class Question:
    """What a caller asks.

    Args:
        constraints: of the state stream.
        timeout: seconds of the wall clock.
    """

    formula: str
    grounding: Grounding
    constraints: StreamConstraints
    timeout: float


class FormulaEvaluation:
    """Grounds a formula, has it evaluated, and cleans up behind it.

    Args:
        name: of the formula, its group and its state stream; unique in the system.
        results: the topic on which the reasoning engine publishes its results.
    """

    def __init__(
        self, node: DyKnowNode, clients: Clients, name: str, question: Question, results: str
    ) -> None:
        self.name = name
        self.question = question
        self.canonical_formula = ''
        self.group_id: int | None = None
        self.formula_id: int | None = None
        self.outcome: Future = Future()
        self._node = node
        self._clients = clients
        self._results = results
        self._state_topic = f'dyknow/streams/{name}'
        self._evaluation = Evaluation(question.formula, self.outcome.set_result)
        self._violations: Any = None
        self._stream_requested = False
        self._lease = Lease(node, on_lost=self._engine_lost)

    @property
    def running(self) -> bool:
        """Whether the state stream flows and no outcome is known yet."""
        return self._evaluation.phase is Phase.RUNNING

    async def run(self) -> None:
        """Takes the steps, then waits for the outcome and leaves nothing behind; never raises."""
        seconds = self.question.timeout
        expiry = self._node.deadlines.after(seconds)
        expiry.add_done_callback(lambda _: self._evaluation.expire(seconds))
        engine = self._clients.stream_reasoning_engine
        engine.on_lost.append(self._reasoning_engine_lost)
        try:
            await self._ground_and_start()
            await self.outcome
        except DyKnowError as error:
            self._evaluation.fail(error)
        except Exception as error:  # noqa: BLE001 - the caller must get an answer
            self._node.get_logger().error(f'fault in the evaluation {self.name}: {error!r}')
            self._evaluation.fail(
                CoordinationError(f'fault in DyKnow: {error!r}', ExitCode.INTERNAL_ERROR)
            )
        expiry.cancel()
        engine.on_lost.remove(self._reasoning_engine_lost)
        await self._clean_up()

    def cancel(self) -> None:
        """Ends the evaluation without a verdict."""
        self._evaluation.cancel()

    def receive(self, result: Any) -> None:
        """Takes the reasoning engine's result for this formula (step 8)."""
        status = result.exit_status
        if status.code != ExitCode.SUCCESS:
            self._evaluation.fail(CoordinationError(status.message, ExitCode(status.code)))
        else:
            self._evaluation.decide(
                Verdict(result.verdict),
                time_to_nanoseconds(result.decided_at),
                result.explanation,
            )

    async def _ground_and_start(self) -> None:
        clients, question = self._clients, self.question
        # Step 1 is the caller's request. Step 2: a formula group with the formula in it.
        self.group_id = await clients.create_group(self.name)
        self.formula_id, self.canonical_formula = await clients.add_formula(
            self.group_id, self.name, question.formula
        )
        # Step 3: the symbols of the formula.
        symbols = await clients.symbols(self.group_id)
        check_grounding(symbols, question.grounding)
        # Step 4: the domain of each sort.
        domains = {sort: await clients.instances(sort) for sort in sorts(symbols)}
        # Step 5: the streams that match each feature.
        found = await self._find_sources(symbols)
        # Step 7: the reasoning engine listens before the first state can come. With the domains
        # fixed, it knows the ground features that each state must hold.
        await clients.evaluate_group(self.group_id, domains, self._state_topic, self._results)
        ground_features = features(await clients.symbols(self.group_id))
        if not ground_features:
            return  # A formula over no feature is decided without a state.
        # Step 6: one stream of states out of the streams of the ground features.
        chosen = choose([str(feature) for feature in ground_features], found)
        # Steps 9 to 11: the stream manager has a stream processing engine make the states.
        await self._create_state_stream(state_specification(chosen))
        # Steps 12 and 13 come to `receive` and to `_violated`.
        self._evaluation.run()

    async def _find_sources(self, symbols: tuple[Symbol, ...]) -> list[Source]:
        sort_names = sorts(symbols)
        found: list[Source] = []
        for number, feature in enumerate(features(symbols), start=1):
            if feature.is_reference:
                found.append(referenced(feature, number))
            else:
                concept = concept_of(feature, sort_names)
                found += sources(await self._clients.matching_streams(concept))
        return found

    async def _create_state_stream(self, specification: str) -> None:
        self._stream_requested = True
        topic, violations = await self._clients.create_stream(
            self.name, specification, self.question.constraints
        )
        expected = self._node.resolve_topic_name(self._state_topic)
        if topic != expected:
            raise CoordinationError(
                f'the states are published on {topic}, and {expected} is listened to; run the '
                'stream processing engine in the namespace of the coordinator',
                ExitCode.UNAVAILABLE,
            )
        self._violations = self._node.create_subscription(
            ConstraintViolation,
            violations,
            self._violated,
            VIOLATIONS,
            callback_group=self._node.reentrant,
            event_callbacks=SubscriptionEventCallbacks(
                liveliness=self._lease.changed, use_default_callbacks=False
            ),
        )
        self._lease.expect()

    def _violated(self, violation: Any) -> None:
        self._evaluation.violate(violation.message)

    def _engine_lost(self) -> None:
        self._evaluation.lose('the stream processing engine')

    def _reasoning_engine_lost(self) -> None:
        # Its groups are gone with it; the next one by its name may give the same number again.
        self.group_id = None
        self._evaluation.lose(f'node {self._clients.stream_reasoning_engine.name}')

    async def _clean_up(self) -> None:
        self._lease.ignore()
        if self._violations is not None:
            self._node.destroy_subscription(self._violations)
        if self._stream_requested:
            await self._let_go(self._clients.destroy_stream(self.name))
        if self.group_id is not None:
            await self._let_go(self._clients.destroy_group(self.group_id))

    async def _let_go(self, destruction: Any) -> None:
        try:
            await destruction
        except DyKnowError as error:
            # NOT_FOUND: it died with the node that held it, and nothing is left.
            if error.code is not ExitCode.NOT_FOUND:
                self._node.get_logger().warning(f'{self.name} could not be cleaned up: {error}')


def fill_answer(answer: Any, evaluation: FormulaEvaluation, outcome: Outcome) -> None:
    """Writes an outcome into the response of the service or the result of the action."""
    answer.verdict = int(outcome.verdict)
    answer.canonical_formula = evaluation.canonical_formula
    answer.explanation = outcome.explanation
    if outcome.decided_at is not None:
        answer.decided_at = nanoseconds_to_time(outcome.decided_at)
    if outcome.error is not None:
        fill_exit_status(answer.exit_status, outcome.error)
