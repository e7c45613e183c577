"""The probability of a formula from its first state on, with what it assumes.

The time constants of the uncertain numbers decide how it is computed:

    missing in one or more    bounds: nothing is known about correlation (`bounds`); also for errors
                              that are bounded, not normal
    0 in all                  exact: errors are independent (`chain`)
    other                     an interval with a confidence, of simulated runs (`simulation`)

Samples of a particle filter are counted, for an interval with a confidence.

Distances, `abs(x)` and `hypot(x, y)`, have bounds if the joint distribution of their operands is
known: from covariances, or because errors are independent (`distances`). Other functions of such
numbers, and several atoms, are simulated at one state. Runs are simulated, too, where atoms compare
different sums of the same independent errors, `x - y < 2` and `x < 1`: they have no exact chain.

The exact probability of a formula where the errors of all states are independent.

The remaining formula after a state is a Markov chain: it depends on the remaining formula before
the state, and on the truth of the atoms, whose distribution depends on no other state. So the
distribution of the remaining formula is all there is to know. Example, a formula that has seen no
state, `always (p -> eventually[0, 2 s] q)`, where p and q have a probability of 0.5 at each state:

    after the state at    always (...)    ... and eventually q to 2 s    ... to 3 s    false
    0 s                   0.75            0.25                           0             0
    1 s                   0.6875          0.125                          0.1875        0
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Sequence
from copy import copy, deepcopy
from typing import Final, TypeAlias

from dyknow_common import ProbabilityInterval, shortened
from dyknow_reasoning.errors import ReasoningError, UnusableValueError
from dyknow_reasoning.execution.automata.automaton import Automaton, Location, Times
from dyknow_reasoning.execution.probability.bounds import operator_of, state_parts
from dyknow_reasoning.execution.probability.distributions import Cells, Chance, StateDistribution
from dyknow_reasoning.execution.probability.simulation import RUNS, CountedSamples, SimulatedRuns
from dyknow_reasoning.language.constants import NO_CONSTANTS, Constants
from dyknow_reasoning.language.formula import Atom, Comparison, Previous, contains
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.language.terms import Probability, Sampled, Uncertain
from dyknow_reasoning.language.type_checking import Kinds, check_types
from dyknow_reasoning.progression.atoms import Values, fields
from dyknow_reasoning.progression.instances import Domains, ground, past_operands
from dyknow_reasoning.progression.node_store import NodeStore
from dyknow_reasoning.progression.nodes import Chronology, Literal, Node, has_windows
from dyknow_reasoning.progression.residual import holds_at_the_end

NOTHING_KNOWN: Final = 'assuming nothing about correlation'
INDEPENDENT: Final = 'assuming independent errors'
COVARIANCES: Final = ' but for the covariances'
BOUNDED: Final = 'assuming errors within their bounds'
_ROUNDING: Final = 1e-10
"""The greatest error of the sums of a long recording."""

SAMPLED: Final = 'with 95 % confidence, of independent samples'
SIMULATED: Final = f'with 95 % confidence, of {RUNS} simulated runs'

MAX_REMAINDERS: Final = 2000
"""The most remaining formulas; the least likely others are not followed, and stay undecided."""


_Model: TypeAlias = 'RemainderChain | SimulatedRuns | _BoundsModel'
"""A way to compute the probability of a formula."""


class FormulaProbability:
    """The probability of a formula from its first state on.

    Args:
        node: the formula, without operators of the past.
        atoms: the atom of each slot.
        kinds: the kinds of the features.

    Attributes:
        assumption: what the probability depends on, in words.
        is_of_state: True if later states do not matter, as there are no temporal operators.

    Raises:
        ReasoningError: if it has no probability.
    """

    def __init__(self, node: Node, atoms: Sequence[Atom], kinds: Kinds) -> None:
        if not any(contains(atom, Uncertain) for atom in atoms):
            raise ReasoningError(
                "nothing in 'P(...)' is uncertain; give a feature an uncertainty, or write "
                'normal(x, DEVIATION) or within(x, ERROR)'
            )
        distribution = StateDistribution(atoms, kinds, node.mask)
        self._model, self.assumption = _model_of(node, atoms, kinds, distribution)
        if distribution.has_covariances and self.assumption != SIMULATED:
            self.assumption += COVARIANCES
        self.is_of_state = not has_windows(node)
        self._is_lost = False
        self._names = sorted({str(each) for atom in atoms for each in fields(atom)})
        # A hash of the states so far, if later states matter.
        self._history = 0

    @property
    def is_final(self) -> bool:
        """True if no further state changes the probability."""
        return self._is_lost or self._model.is_final

    def step(self, time: int, values: Values) -> None:
        """Take a state; after states that are missing, it has no effect.

        Raises:
            ReasoningError: if a value is unusable.
        """
        if self.is_final:
            return
        self._model.step(time, values)
        if not self.is_of_state:
            self._history = hash((self._history, time, *(repr(values.get(x)) for x in self._names)))

    @property
    def key(self) -> Hashable:
        """Equal for copies with one future."""
        return self._history, self._is_lost

    def at_state(self, time: int, values: Values) -> FormulaProbability:
        """Take a state; return the probability at it, of this state alone if `is_of_state`.

        Raises:
            ReasoningError: if a value is unusable.
        """
        found = self.copied() if self.is_of_state else self
        found.step(time, values)
        return found

    def gap(self) -> None:
        """Record that states are missing: what is open stays undecided."""
        self._is_lost = True

    def interval(self) -> ProbabilityInterval:
        """Return the probability, for any states that may come."""
        return self._interval(self._model.chance(ended=False))

    def interval_at_end(self) -> ProbabilityInterval:
        """Return the probability if no further state comes."""
        return self._interval(self._model.chance(ended=not self._is_lost))

    def _interval(self, chance: Chance) -> ProbabilityInterval:
        """Return the interval of a chance, with the errors of its rounding unless it is certain."""
        lower = 1.0 if chance[0] == 1.0 else max(0.0, chance[0] - _ROUNDING)
        upper = 0.0 if chance[1] == 0.0 else min(1.0, chance[1] + _ROUNDING)
        return ProbabilityInterval(lower, upper, self.assumption)

    def copied(self) -> FormulaProbability:
        """Return an independent copy."""
        found = copy(self)
        found._model = self._model.copied()  # noqa: SLF001 - of the same class
        return found


def _model_of(
    node: Node, atoms: Sequence[Atom], kinds: Kinds, distribution: StateDistribution
) -> tuple[_Model, str]:
    """Return how the probability is computed, and what that assumes."""
    constants = {each.time_constant for each in distribution.numbers}
    is_of_state = not has_windows(node)
    if any(isinstance(each, Sampled) for each in distribution.numbers):
        if not (is_of_state and all(isinstance(each, Sampled) for each in distribution.numbers)):
            raise ReasoningError(
                'samples are those of one state; ask for the probability at each state, of a '
                'formula without temporal operators, and of numbers with samples alone'
            )
        return CountedSamples(node, atoms, kinds, distribution), SAMPLED
    if distribution.has_cells and constants <= {0}:
        return RemainderChain(node, distribution), INDEPENDENT
    is_single = isinstance(node, Literal) and distribution.has_bounds
    is_known = is_of_state and (distribution.has_cells or is_single)
    is_joint = distribution.is_joint and is_of_state and not distribution.is_linear
    if not is_known and (None not in constants or is_joint):
        return SimulatedRuns(node, atoms, kinds, distribution), SIMULATED
    if not distribution.has_bounds:
        raise ReasoningError(
            'an operand is no sum of uncertain numbers and multiples of these, and no abs or '
            'hypot of two or three such sums with all covariances; give each a normal error with a '
            'time constant, such as normal(x, s, 0 s), or at one state all their covariances, then '
            'runs are simulated'
        )
    if None not in constants:
        return _BoundsModel(node, distribution), INDEPENDENT
    assumption = BOUNDED if distribution.is_bounded else NOTHING_KNOWN
    return _BoundsModel(node, distribution), assumption


class _BoundsModel:
    """Bounds where nothing is known about correlation."""

    def __init__(self, node: Node, distribution: StateDistribution) -> None:
        self._distribution = distribution
        order = {part: index for index, part in enumerate(dict.fromkeys(state_parts(node)))}
        self._parts = tuple(order)
        self._operator = operator_of(node, order, first_only=True)
        self._known: Chance | None = None
        self._latest: int | None = None

    @property
    def is_final(self) -> bool:
        return self._known is not None

    def step(self, time: int, values: Values) -> None:
        if self._known is None:
            moments = self._distribution.moments(values)
            chances = [self._distribution.chance(x, values, moments) for x in self._parts]
            found = self._operator.step(time, chances)
            self._known, self._latest = next(iter(found), None), time

    def copied(self) -> _BoundsModel:
        found = copy(self)
        found._operator = deepcopy(self._operator)  # noqa: SLF001 - of the same class
        return found

    def chance(self, *, ended: bool) -> Chance:
        if self._known is not None:
            return self._known
        if self._latest is None:
            return 0.0, 1.0
        return next(self._operator.open(self._latest, ended=ended))


def probability_of(
    text: str, domains: Domains, constants: Constants = NO_CONSTANTS
) -> FormulaProbability:
    """Return the probability that is asked for.

    Args:
        text: a comparison of a probability, `P(always normal(x, s) > 0) >= 0`.
        domains: the objects of each sort.
        constants: the values of names that the text does not define.

    Raises:
        LanguageError: for a text that is not a formula.
        ReasoningError: if it has no probability.
    """
    formula = parse_formula(text, constants)
    kinds = check_types(formula, text)
    probability = formula.left if isinstance(formula, Comparison) else None
    if not isinstance(probability, Probability):
        message = f"'{shortened(formula)}' is no comparison of a probability with a number"
        raise ReasoningError(f'{message}, such as P(...) >= 0.9')
    body = ground(probability.body, {}, domains)
    operands = past_operands(Previous(body), NodeStore(Chronology()))
    return FormulaProbability(operands.right, operands.atoms, kinds)


class AskedProbability:
    """The probability of a formula at a state, for comparisons with numbers.

    A comparison is true once it is known to be true. It is an error if it will never be known, so
    the formula has no verdict.

    Args:
        interval: the probability.
        formula: its text.
        is_final: True if no further state changes the interval.
    """

    def __init__(self, interval: ProbabilityInterval, formula: str, *, is_final: bool) -> None:
        self._interval, self._formula, self._is_final = interval, formula, is_final

    def __str__(self) -> str:
        return str(self._interval)

    def __ge__(self, bound: float) -> bool:
        return self._is_known(bound, self._interval.lower >= bound, self._interval.upper < bound)

    def __gt__(self, bound: float) -> bool:
        return self._is_known(bound, self._interval.lower > bound, self._interval.upper <= bound)

    def __le__(self, bound: float) -> bool:
        return self._is_known(bound, self._interval.upper <= bound, self._interval.lower > bound)

    def __lt__(self, bound: float) -> bool:
        return self._is_known(bound, self._interval.upper < bound, self._interval.lower >= bound)

    def _is_known(self, bound: float, *sides: bool) -> bool:
        """Return the first side; raise UnusableValueError if neither side is known."""
        if self._is_final and not any(sides):
            is_bound = self._interval.assumption.startswith(NOTHING_KNOWN)
            correction = 'give the errors a time constant, or ' if is_bound else ''
            raise UnusableValueError(  # Of a later state, it may be known.
                f"the probability of '{self._formula}' is {self._interval}, which is not known to "
                f'be on one side of {bound:g}; {correction}compare with another number'
            )
        return sides[0]


class RemainderChain:
    """The distribution of what remains of a formula.

    Args:
        node: the formula, which has seen no state.
        distribution: the distribution of its atoms; it must have cells.
    """

    def __init__(self, node: Node, distribution: StateDistribution) -> None:
        self._distribution = distribution
        self._automaton = Automaton(node)
        self._open: dict[tuple[Location, Times], float] = {(self._automaton.initial, ()): 1.0}
        self._decided = {True: 0.0, False: 0.0}
        if self._automaton.initial.verdict is not None:
            self._open, self._decided[self._automaton.initial.verdict] = {}, 1.0

    @property
    def is_final(self) -> bool:
        """True if no further state changes the bounds."""
        return not self._open

    def step(self, time: int, values: Values) -> None:
        """Take a state; raise ReasoningError if a value is unusable."""
        if not self._open:
            return
        moments = self._distribution.moments(values)
        cells: dict[int, Cells] = {}
        after: defaultdict[tuple[Location, Times], float] = defaultdict(float)
        for (location, clocks), before in self._open.items():
            mask = location.node.mask
            if mask not in cells:
                cells[mask] = self._distribution.cells(mask, values, moments)
            times = (*clocks, time)
            for symbol, chance in cells[mask]:
                move = self._automaton.move(location, symbol, times)
                verdict = move.target.verdict
                if verdict is None:
                    after[move.target, move.select(times)] += before * chance
                else:
                    self._decided[verdict] += before * chance
        self._open = after
        if len(after) > MAX_REMAINDERS:
            likely = sorted(after.items(), key=lambda item: -item[1])
            self._open = dict(likely[:MAX_REMAINDERS])
        if self._automaton.is_full:
            self._automaton.forget({location for location, _ in self._open})

    def chance(self, *, ended: bool) -> Chance:
        """Return the bounds of the probability if no further state comes, or if any may."""
        if not ended:
            return self._decided[True], 1.0 - self._decided[False]
        held = sum(
            chance
            for (location, _), chance in self._open.items()
            if holds_at_the_end(location.node)
        )
        lost = 1.0 - sum(self._decided.values()) - sum(self._open.values())
        found = self._decided[True] + held
        return found, found + lost

    def copied(self) -> RemainderChain:
        """Return an independent copy."""
        found = copy(self)
        found._open, found._decided = dict(self._open), dict(self._decided)  # noqa: SLF001
        return found
