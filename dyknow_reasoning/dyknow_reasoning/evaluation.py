"""The evaluation of one formula: its instances, progressed state by state until all is decided."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from typing import TYPE_CHECKING

from dyknow_reasoning.atoms import Predicate, Values, predicate
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.explanation import Moment, explain
from dyknow_reasoning.nodes import FALSE, Constant, Node, Window, slots
from dyknow_reasoning.residual import residual_text
from dyknow_reasoning.results import Verdict
from dyknow_stream_processing import ExitCode

if TYPE_CHECKING:
    from collections.abc import Sequence

    from dyknow_reasoning.grounding import Instance
    from dyknow_reasoning.progression import Progression
    from dyknow_reasoning.type_checking import Kinds

_WHATEVER = {
    Verdict.TRUE: 'true for these objects, whatever the states are',
    Verdict.FALSE: 'false for these objects, whatever the states are',
}


@dataclass(frozen=True, slots=True)
class Decision:
    """A verdict and its explanation."""

    verdict: Verdict
    explanation: str


class Evaluation:
    """Progresses a formula.

    Args:
        instances: what must all hold.
        kinds: the kinds of the features.
        node_limit: the nodes that the instances may have together.
    """

    def __init__(self, instances: Sequence[Instance], kinds: Kinds, node_limit: int) -> None:
        self.instances = instances
        self._node_limit = node_limit
        self._running = [
            _Running(instance, [predicate(atom, kinds) for atom in instance.atoms])
            for instance in instances
            if type(instance.node) is not Constant
        ]
        self._false = any(instance.node is FALSE for instance in instances)
        self._size = sum(running.node.size for running in self._running)

    @property
    def roots(self) -> list[Node]:
        """What remains of the undecided instances."""
        return [running.node for running in self._running]

    @property
    def residual(self) -> str:
        """The canonical text of what remains; its intervals count from the latest state."""
        if self._false:
            return 'false'
        texts = [running.text for running in self._running] or ['true']
        return reduce(lambda left, right: f'({left}) and ({right})', texts)

    def decide_at_once(self) -> Decision | None:
        """The decision of a formula that needs no state."""
        if self._running and not self._false:
            return None
        verdict = Verdict.FALSE if self._false else Verdict.TRUE
        return Decision(verdict, _WHATEVER[verdict])

    def progress(
        self, valid_time: int, elapsed: int, values: Values, progression: Progression
    ) -> Decision | None:
        """Progresses the formula over a state; returns the decision that this state brings.

        Args:
            valid_time: of the state, in nanoseconds.
            elapsed: the nanoseconds since the state before; 0 at the first.
            values: of the ground features.
            progression: knows the nodes of the instances.

        Raises:
            ReasoningError: when the state lacks what the formula needs, or the formula grows too
                large.
        """
        # All values are read first, so that a bad one is an error whatever the others say.
        for running in self._running:
            running.read(values)
        finished: list[tuple[_Running, Moment]] = []
        for running in self._running:
            before = running.node
            node = progression.progress(before, running.symbol, elapsed)
            if type(node) is Constant:
                finished.append((running, running.moment(elapsed, valid_time, values)))
                self._size -= before.size
                self._false = node is FALSE
                if self._false:
                    break
            elif node is not before or not elapsed:
                running.advance(node, valid_time)
                self._grow(node.size - before.size)
        return self._finish(finished, progression) if finished else None

    def _grow(self, nodes: int) -> None:
        self._size += nodes
        if self._size > self._node_limit:
            raise ReasoningError(
                f'the formula has grown to {self._size} nodes, more than {self._node_limit}; '
                'bound its intervals, lengthen the sample period, or raise the node limit',
                ExitCode.UNAVAILABLE,
            )

    def _finish(
        self, finished: Sequence[tuple[_Running, Moment]], progression: Progression
    ) -> Decision | None:
        """Takes out decided instances; the formula is decided if one is false or all are true."""
        gone = {id(running) for running, _ in finished}
        self._running = [running for running in self._running if id(running) not in gone]
        if self._running and not self._false:
            return None
        _, moment = finished[-1]
        verdict = Verdict.FALSE if self._false else Verdict.TRUE
        return Decision(verdict, explain(moment, progression))


class _Running:
    """An undecided instance."""

    __slots__ = ('_active', '_mask', '_predicates', 'instance', 'node', 'opened', 'symbol')

    def __init__(self, instance: Instance, predicates: Sequence[Predicate]) -> None:
        self.instance = instance
        self.node = instance.node
        self.symbol = 0
        self.opened: dict[Window, int] = {}
        self._predicates = predicates
        self._mask = 0
        self._active: list[tuple[int, Predicate]] = []
        self._activate(self.node.mask)

    @property
    def text(self) -> str:
        return residual_text(self.node, self.instance.atoms)

    def read(self, values: Values) -> None:
        """Takes the truth of the atoms that the instance still depends on, as bits of `symbol`."""
        symbol = 0
        for bit, holds in self._active:
            if holds(values):
                symbol |= bit
        self.symbol = symbol

    def moment(self, elapsed: int, valid_time: int, values: Values) -> Moment:
        """What is known of a state, for explaining what it decides."""
        return Moment(
            self.instance, self.node, self.symbol, elapsed, valid_time, values, self.opened
        )

    def advance(self, node: Node, valid_time: int) -> None:
        """Takes what remains after the state of that valid time."""
        if node.mask != self._mask:
            self._activate(node.mask)
        if node.unbounded != self.node.unbounded or not self.opened:
            self.opened = {window: self.opened.get(window, valid_time) for window in node.unbounded}
        self.node = node

    def _activate(self, mask: int) -> None:
        self._mask = mask
        self._active = [(1 << slot, self._predicates[slot]) for slot in slots(mask)]
