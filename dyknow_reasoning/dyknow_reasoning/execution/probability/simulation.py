"""The probability of a formula in simulated runs, where errors are correlated over time.

The error of each uncertain number is a first-order Gauss-Markov process: a time t after a state,
the correlation with the error at that state is exp(-t / time constant). Each run draws errors, adds
them to the estimates, and progresses the formula over the sums. The share of true and false runs
gives an interval with a confidence of 95 % (Clopper and Pearson 1934). The confidence is valid at
every state, not only at one: later intervals lie in earlier ones.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from copy import copy
from functools import lru_cache
from math import exp, sqrt
from typing import Any, Final, TypeAlias
from zlib import crc32

import numpy as np
import numpy.typing as npt

from dyknow_common import COMPARISONS, shortened
from dyknow_reasoning.errors import ReasoningError, UnusableValueError
from dyknow_reasoning.execution.automata.automaton import Automaton, Location, Times
from dyknow_reasoning.execution.probability.distances import TOLERANCE, special_functions
from dyknow_reasoning.execution.probability.distributions import (
    Chance,
    StateDistribution,
    no_distribution,
)
from dyknow_reasoning.language.formula import Atom, Comparison, contains
from dyknow_reasoning.language.terms import Arithmetic, Function, Term, Uncertain
from dyknow_reasoning.language.type_checking import Kinds
from dyknow_reasoning.progression.atoms import CALCULATE, Values, predicate, term_reader
from dyknow_reasoning.progression.functions import call_function_on_vectors
from dyknow_reasoning.progression.nodes import Node, slots
from dyknow_reasoning.progression.residual import holds_at_the_end

RUNS: Final = 1000
"""The number of simulated runs."""

CONFIDENCE: Final = 0.95
"""The probability that the interval contains the probability."""

_MAX_ATOMS: Final = 32

_MAX_CODES: Final = 1 << 12
"""The most numbers that are grouped by a table; more are sorted."""

_Numbers: TypeAlias = npt.NDArray[np.float64]
_Indices: TypeAlias = npt.NDArray[np.int64]
_Vectors: TypeAlias = Sequence[_Numbers]
"""The uncertain numbers in each run."""


class SimulatedRuns:
    """Runs of a formula over simulated errors.

    Args:
        node: the formula, which has seen no state.
        atoms: the atom of each slot.
        kinds: the kinds of the features.
        distribution: the distribution of the atoms.

    Raises:
        ReasoningError: if scipy is not installed, or the formula has too many atoms.
    """

    def __init__(
        self, node: Node, atoms: Sequence[Atom], kinds: Kinds, distribution: StateDistribution
    ) -> None:
        self._distribution, self._runs = distribution, RUNS
        self._interval = _clopper_pearson()
        self._readers = _vector_readers(node, atoms, kinds, distribution.numbers)
        self._automaton = Automaton(node)
        initial = self._automaton.initial
        # The same formula draws the same errors, live and recorded.
        self._generator = np.random.default_rng(crc32(' '.join(map(str, atoms)).encode()))
        self._counts = {True: 0, False: 0}
        self._latest: int | None = None
        # The open runs: the index of each one's place in the list of places, and its errors.
        self._places: list[tuple[Location, Times]] = [(initial, ())]
        self._at = np.zeros(RUNS, np.int64)
        self._errors: list[_Numbers] = []
        if initial.verdict is not None:
            self._counts[initial.verdict], self._at = RUNS, self._at[:0]

    @property
    def is_final(self) -> bool:
        """True if no further state changes the bounds."""
        return not len(self._at)

    def step(self, time: int, values: Values) -> None:
        """Take a state; raise ReasoningError if a value is unusable."""
        if not len(self._at):
            return
        vectors = self._drawn(time, values)
        needed = 0
        for location, _ in self._places:
            needed |= location.node.mask
        symbols = np.zeros(len(self._at), np.int64)
        for slot in slots(needed):
            symbols |= np.asarray(self._readers[slot](values, vectors), np.int64) << slot
        size = int(symbols.max()) + 1
        symbols += self._at * size
        kinds, members = _grouped(symbols)
        self._move([divmod(each, size) for each in kinds], members, time)
        if self._automaton.is_full:
            self._automaton.forget({location for location, _ in self._places})

    def chance(self, *, ended: bool) -> Chance:
        """Return the interval of the probability if no further state comes, or if any may."""
        if not ended:
            return self._interval(self._counts[True], self._runs - self._counts[False], self._runs)
        counts = np.bincount(self._at, minlength=len(self._places)).tolist()
        places = zip(self._places, counts, strict=True)
        held = sum(count for (each, _), count in places if holds_at_the_end(each.node))
        return self._interval(self._counts[True] + held, self._counts[True] + held, self._runs)

    def copied(self) -> SimulatedRuns:
        """Return an independent copy, which draws the same errors."""
        found = copy(self)
        # Quicker than a deep copy; the probability of one state needs a copy at each state.
        generator = found._generator = np.random.Generator(np.random.PCG64(0))  # noqa: SLF001
        generator.bit_generator.state = self._generator.bit_generator.state
        found._counts, found._errors = dict(self._counts), list(self._errors)  # noqa: SLF001
        return found

    def _drawn(self, time: int, values: Values) -> _Vectors:
        """Draw the errors at a state, and return the uncertain numbers in each run."""
        elapsed = None if self._latest is None else time - self._latest
        self._latest = time
        moments, numbers = self._distribution.moments(values), self._distribution.numbers
        drawn = list(self._generator.standard_normal((len(numbers), len(self._at))))
        for number, errors, before in zip(numbers, drawn, self._errors, strict=False):
            if elapsed is not None and number.time_constant:
                correlation = exp(-elapsed / number.time_constant)
                np.multiply(errors, sqrt(1.0 - correlation * correlation), out=errors)
                np.add(errors, correlation * before, out=errors)
        self._errors = drawn
        found = [
            mean + deviation * errors
            for (mean, deviation), errors in zip(moments, drawn, strict=True)
        ]
        for members, matrix in self._distribution.covariance_matrices(values, moments):
            # The symmetric root: it changes little if the covariances do.
            scales, axes = np.linalg.eigh(matrix)
            if scales[0] < -TOLERANCE * scales[-1]:
                raise no_distribution([numbers[each] for each in members])
            root = axes * np.sqrt(np.maximum(scales, 0)) @ axes.T
            together = root @ np.array([drawn[each] for each in members])
            for each, errors in zip(members, together, strict=True):
                found[each] = moments[each][0] + errors
        return found

    def _move(self, kinds: Sequence[tuple[int, int]], members: _Indices, time: int) -> None:
        """Move the open runs, given the place and the truth of the atoms of each kind."""
        places: dict[tuple[Location, Times], int] = {}
        targets = np.empty(len(kinds), np.int64)
        counts = np.bincount(members, minlength=len(kinds)).tolist()
        for index, (place, symbol) in enumerate(kinds):
            location, clocks = self._places[place]
            times = (*clocks, time)
            move = self._automaton.move(location, symbol & location.node.mask, times)
            if move.target.verdict is None:
                found = move.target, move.select(times)
                targets[index] = places.setdefault(found, len(places))
            else:
                targets[index] = -1
                self._counts[move.target.verdict] += counts[index]
        self._places, self._at = list(places), targets[members]
        if targets.min() < 0:
            is_open = self._at >= 0
            self._at = self._at[is_open]
            self._errors = [each[is_open] for each in self._errors]


class CountedSamples(SimulatedRuns):
    """The samples of a state, in place of runs of a formula without temporal operators.

    Sample i of all numbers belongs to one particle, so the joint truth of the atoms is known.
    """

    def __init__(
        self, node: Node, atoms: Sequence[Atom], kinds: Kinds, distribution: StateDistribution
    ) -> None:
        super().__init__(node, atoms, kinds, distribution)
        self._samples = [term_reader(each.deviation, kinds) for each in distribution.numbers]

    def _drawn(self, time: int, values: Values) -> _Vectors:  # noqa: ARG002
        numbers = self._distribution.numbers
        vectors = [
            _samples_of(each, read(values))
            for each, read in zip(numbers, self._samples, strict=True)
        ]
        if len({len(each) for each in vectors}) > 1:
            lengths = {
                f"'{each.mean}'": len(found) for each, found in zip(numbers, vectors, strict=True)
            }
            raise UnusableValueError(
                f'samples differ in number: {lengths}; take them from one message'
            )
        self._runs = len(vectors[0])
        self._at = np.zeros(self._runs, np.int64)
        return vectors


def _samples_of(number: Uncertain, text: str) -> _Numbers:
    """Return the samples in a text; raise ReasoningError if it has none, or other contents."""
    try:
        found = np.array(text.split(), np.float64)
    except ValueError:
        found = np.full(1, np.nan)
    if not (len(found) and np.isfinite(found).all()):
        raise UnusableValueError(
            f"the samples of '{number.mean}' are '{shortened(text)}'; they are one or more finite "
            'numbers, with spaces between them'
        )
    return found


def _grouped(codes: _Indices) -> tuple[list[int], _Indices]:
    """Return the distinct codes, and for each given code its index among them."""
    most = int(codes.max()) + 1
    if most > _MAX_CODES:
        kinds, members = np.unique(codes, return_inverse=True)
        return kinds.tolist(), members.ravel()
    kinds = np.flatnonzero(np.bincount(codes, minlength=most))
    index = np.empty(most, np.int64)
    index[kinds] = np.arange(len(kinds))
    return kinds.tolist(), index[codes]


def _vector_readers(
    node: Node, atoms: Sequence[Atom], kinds: Kinds, numbers: Sequence[Uncertain]
) -> Mapping[int, Callable[[Values, _Vectors], Any]]:
    """Return a function for each slot that reads the truth of its atom in each run."""
    if len(atoms) > _MAX_ATOMS:
        message = f'the formula has {len(atoms)} atoms; at most {_MAX_ATOMS} are simulated'
        raise ReasoningError(message)
    return {slot: _vector_reader(atoms[slot], kinds, numbers) for slot in slots(node.mask)}


def _vector_reader(
    atom: Atom, kinds: Kinds, numbers: Sequence[Uncertain]
) -> Callable[[Values, _Vectors], Any]:
    """Return the truth of an atom in each run, or its only truth."""
    if not isinstance(atom, Comparison) or not contains(atom, Uncertain):
        holds = predicate(atom, kinds)
        return lambda values, _: holds(values)
    compare = COMPARISONS[atom.operator]
    left, right = (_number_reader(each, kinds, numbers) for each in (atom.left, atom.right))

    def read(values: Values, vectors: _Vectors) -> Any:
        return compare(left(values, vectors), right(values, vectors))

    return read


def _number_reader(
    term: Term, kinds: Kinds, numbers: Sequence[Uncertain]
) -> Callable[[Values, _Vectors], Any]:
    """Return the values of a term in each run, or its only value."""
    if isinstance(term, Uncertain):
        index = numbers.index(term)
        return lambda _, vectors: vectors[index]
    if not contains(term, Uncertain):
        read_one = term_reader(term, kinds)
        return lambda values, _: read_one(values)
    if not isinstance(term, Arithmetic | Function):
        raise ReasoningError(f"'{term}' of an uncertain number cannot be simulated")
    operands = (term.left, term.right) if isinstance(term, Arithmetic) else term.arguments
    readers = [_number_reader(each, kinds, numbers) for each in operands]

    def read(values: Values, vectors: _Vectors) -> Any:
        found = [each(values, vectors) for each in readers]
        if isinstance(term, Arithmetic):
            with np.errstate(all='ignore'):
                result = CALCULATE[term.operator](*map(np.asarray, found))
        else:
            result = call_function_on_vectors(term.name, found)
        if not np.isfinite(result).all():
            raise UnusableValueError(f"'{term}' has no value for some of the simulated errors")
        return result

    return read


def _clopper_pearson() -> Callable[..., Chance]:
    """Return a function of the least and the greatest number of true runs, and of all runs."""
    betaincinv = special_functions().betaincinv
    tail = (1.0 - CONFIDENCE) / 2

    @lru_cache(1)  # It rarely changes from one state to the next.
    def interval(least: int, most: int, runs: int) -> Chance:
        lower = float(betaincinv(least, runs - least + 1, tail)) if least else 0.0
        upper = float(betaincinv(most + 1, runs - most, 1.0 - tail)) if most < runs else 1.0
        return lower, upper

    return interval
