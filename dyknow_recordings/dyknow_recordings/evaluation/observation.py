"""The signals of an evaluation: the values of its states, in bounded memory."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from dyknow_common import COMPARISONS
from dyknow_reasoning import (
    CALCULATE,
    Arithmetic,
    Comparison,
    Feature,
    FieldReference,
    Formula,
    Function,
    Number,
    PastTerm,
    Probability,
    Sampled,
    StateAtom,
    Term,
    Uncertain,
    best_estimate,
    call_function_on_vectors,
    ground_atoms,
    parse_formula,
    parts,
    walk,
)
from dyknow_recordings.evaluation.bands import (
    Band,
    ForecastBand,
    error_band,
    forecast_bands,
    probability_track,
)

Times: TypeAlias = npt.NDArray[np.int64]
Numbers: TypeAlias = npt.NDArray[np.float64]

Column: TypeAlias = Sequence[Any] | npt.NDArray[Any]
"""The values of a feature at some states."""

MAX_SPANS: Final = 500
"""The spans of time into which a long signal is divided; each keeps its extremes."""

MAX_POINTS: Final = 5 * MAX_SPANS
"""The number of points of a signal: all, or the first, last, least, greatest and a missing one.

One with a band has three times as many.
"""

MAX_SIGNALS: Final = 200
"""The number of signals of one stream of states that are kept."""

MAX_DECIDING_STATES: Final = 100
"""The number of deciding states whose values are kept."""

_MAX_WORDS: Final = 20
"""The number of different texts of a signal that are kept; all others are one."""

_BANDED: Final = Probability, Uncertain, ForecastBand
"""The terms whose signals have a band."""


@dataclass(frozen=True, slots=True, eq=False)
class Signal:
    """The values of a term over time, with all extremes.

    Args:
        name: the canonical text of the term.
        times: the valid times, in nanoseconds.
        values: NaN where a value is missing. A boolean is 0 or 1, a text is its index in `words`.
        words: the values of a signal that is not a number, by index.
        band: the ends of the interval of an uncertain number, or of a probability, whose values
            are the lower bounds.
    """

    name: str
    times: Times
    values: Numbers
    words: tuple[str, ...] = ()
    band: Band | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StateSignals:
    """The signals of the states that formulas with the same features were evaluated over.

    Args:
        signals: by name.
        domains: the objects of each sort.
        deciding: the values of the signals at the first deciding states, by valid time.
        omitted: the number of signals that were not kept, as there were too many.
    """

    signals: Mapping[str, Signal]
    domains: Mapping[str, tuple[str, ...]]
    deciding: Mapping[int, Mapping[str, float]]
    omitted: int


def features_of(node: Formula | Term | ForecastBand) -> list[Feature | FieldReference]:
    """Return the features in a term, or in an atom without variables."""
    if isinstance(node, ForecastBand):
        return [node.low, node.high]
    if isinstance(node, Feature | FieldReference):
        return [node]
    return [each for part in parts(node) for each in features_of(part)]


def terms_of(formulas: Iterable[str], domains: Mapping[str, Sequence[str]]) -> list[Term]:
    """Return the terms, except constants, that the atoms of formulas compare."""
    found: dict[Term, None] = {}
    for text in formulas:
        for _, atoms in ground_atoms(parse_formula(text), domains):
            for atom in with_inner_atoms(atoms):
                found |= {side: None for side in sides_of(atom) if features_of(side)}
    return list(found)


def with_inner_atoms(atoms: Iterable[StateAtom]) -> Iterator[StateAtom]:
    """Yield atoms, each with the atoms of the formulas whose probability it compares."""
    for atom in atoms:
        yield atom
        for side in sides_of(atom):
            if isinstance(side, Probability):
                for _, inner in ground_atoms(side.body, {}):
                    yield from inner


def sides_of(atom: StateAtom) -> Sequence[Term]:
    """Return the terms that an atom compares; the features of one with values of the past."""
    if not isinstance(atom, Comparison):
        return (atom,)
    sides = atom.left, atom.right
    present = [each for each in sides if not isinstance(each, Probability)]
    if any(isinstance(part, PastTerm) for each in present for part in walk(each)):
        return features_of(atom)
    return sides


def signal_name(term: Term | ForecastBand) -> str:
    """Return the name of the signal of a term; for an uncertain term, of its best estimate."""
    if isinstance(term, ForecastBand):
        return f'{term.low} to {term.high}'
    return str(term if isinstance(term, Probability) else best_estimate(term))


class SignalRecorder:
    """Keeps the signals of some terms.

    Args:
        terms: the features of the states and the terms calculated from them.
        domains: the objects of each sort.
        window: how long a value is kept, in nanoseconds; None: for ever.
        block: the number of single states that are collected to be added together.
        is_asked_once: True if formulas are asked from the first state only, and it is recorded:
            then a probability of the future covers all states.
    """

    def __init__(
        self,
        terms: Iterable[Term],
        domains: Mapping[str, tuple[str, ...]],
        window: int | None = None,
        block: int = 4096,
        *,
        is_asked_once: bool = True,
    ) -> None:
        self._block = block
        named = _named(terms)
        self._terms = dict(list(named.items())[:MAX_SIGNALS])
        self._omitted = len(named) - len(self._terms)
        tracks = {
            name: probability_track(term)
            for name, term in self._terms.items()
            if isinstance(term, Probability)
        }
        self._probabilities = {
            name: track
            for name, track in tracks.items()
            if track is not None and (is_asked_once or track.is_of_state)
        }
        self._domains = domains
        self._signals = {
            name: _GrowingSignal(name, window, 3 if isinstance(term, _BANDED) else 1)
            for name, term in self._terms.items()
        }
        self._times: list[int] = []
        features = (str(each) for term in self._terms.values() for each in features_of(term))
        self._single: dict[str, list[Any]] = {name: [] for name in features}
        self._latest_time = -1
        # All formulas over these states share it.
        self._result: StateSignals | None = None
        self._latest: tuple[Times, dict[str, Numbers]] | None = None
        self._deciding: dict[int, dict[str, float]] = {}

    @property
    def size(self) -> int:
        """The number of signals without a band that need as much memory: one with a band, 6."""
        return sum(each.lines * (each.lines + 1) // 2 for each in self._signals.values())

    def states(self, valid_times: Sequence[int] | Times, columns: Mapping[str, Column]) -> None:
        """Add states that are about to be progressed; single ones are collected first.

        Args:
            valid_times: in nanoseconds, increasing.
            columns: for each feature, its values at these states; may be numpy arrays.
        """
        if len(valid_times) > 1:
            self._flush()
            self._add(np.asarray(valid_times, np.int64), columns)
            return
        self._times.extend(map(int, valid_times))
        for name, single in self._single.items():
            single.extend(columns.get(name, (None,)))
        if len(self._times) >= self._block:
            self._flush()

    def gap(self) -> None:
        """Add a missing value after the states so far, which interrupts the lines of signals."""
        self._flush()
        if self._latest_time >= 0:
            self._result = None
            self._latest_time += 1
            for each in self._signals.values():
                each.miss(self._latest_time)
            for track in self._probabilities.values():
                track.gap()

    def decided(self, valid_time: int) -> None:
        """Keep the values of a deciding state, before the states of a later call."""
        if valid_time in self._deciding or len(self._deciding) >= MAX_DECIDING_STATES:
            return
        self._flush()
        if self._latest is None:
            return
        times, values = self._latest
        found = np.flatnonzero(times == valid_time)
        if len(found):
            index = int(found[0])
            self._deciding[valid_time] = {name: float(each[index]) for name, each in values.items()}

    def result(self) -> StateSignals:
        """Return the signals so far."""
        self._flush()
        if self._result is None:
            signals = {name: each.signal() for name, each in self._signals.items()}
            self._result = StateSignals(signals, self._domains, self._deciding, self._omitted)
        return self._result

    def _flush(self) -> None:
        if self._times:
            times, self._times = np.array(self._times, np.int64), []
            columns, self._single = self._single, {name: [] for name in self._single}
            self._add(times, columns)

    def _add(self, times: Times, columns: Mapping[str, Column]) -> None:
        """Add states; drop a state that is not later than the one before: formulas report it."""
        before = np.maximum.accumulate(np.concatenate([[self._latest_time], times[:-1]]))
        if not (is_later := times > before).all():
            times = times[is_later]
            columns = {name: np.asarray(each)[is_later] for name, each in columns.items()}
        if not len(times):
            return
        self._result = None
        self._latest_time = int(times[-1])
        features = _Features(self._signals, columns, times)
        values: dict[str, Numbers] = {}
        for name, term in self._terms.items():
            lines = [np.broadcast_to(each, times.shape) for each in self._lines(term, features)]
            values[name] = lines[0]
            self._signals[name].add(times, np.column_stack(lines))
        self._latest = times, values

    def _lines(self, term: Term | ForecastBand, features: _Features) -> Sequence[Numbers]:
        """Return the values of a term, and the ends of its band if it has one."""
        numbers = features.numbers
        match term:
            case Probability():
                track = self._probabilities.get(str(term))
                if track is None:
                    return (np.array(np.nan),) * 3
                low, high = track.band(features.times.tolist(), features.columns(term))
                return low, low, high
            case Uncertain(mean, spread):
                is_text = isinstance(term, Sampled)
                spreads = features.columns(spread)[str(spread)] if is_text else numbers(spread)
                means = numbers(mean)
                return means, *error_band(term, means, spreads)
            case ForecastBand(lower, upper):
                low, high = numbers(lower), numbers(upper)
                return low, low, high
            case _:
                return (numbers(term),)


def _named(terms: Iterable[Term]) -> dict[str, Term | ForecastBand]:
    """Return what is recorded as the signal of each name."""
    found: dict[str, Term | ForecastBand] = {}
    named = dict.fromkeys(terms)
    # Other formulas over the same states may have one of both bounds.
    for each in (*named, *forecast_bands(named).values()):
        is_banded, name = isinstance(each, _BANDED), signal_name(each)
        # A number that is also compared without its uncertainty has the band, too.
        if is_banded or name not in found:
            found[name] = each if is_banded else best_estimate(each)
    return found


class _Features:
    """The values of terms over some states, as numbers."""

    def __init__(
        self, signals: Mapping[str, _GrowingSignal], columns: Mapping[str, Column], times: Times
    ) -> None:
        self._signals = signals
        self.times = times
        self._columns = columns

    def numbers(self, term: Term | Comparison) -> Numbers:
        match term:
            # Texts have numbers here that say nothing about them.
            case Comparison(operator, left, right) if Number in {type(left), type(right)}:
                sides = self.numbers(left), self.numbers(right)
                is_missing = np.isnan(sides[0]) | np.isnan(sides[1])
                return np.where(is_missing, np.nan, COMPARISONS[operator](*sides))
            case Number(value):
                return np.array(float(value))
            case Arithmetic(operator, left, right):
                with np.errstate(all='ignore'):
                    result: Numbers = CALCULATE[operator](self.numbers(left), self.numbers(right))
                return result
            case Function(name, operands):
                return call_function_on_vectors(name, [self.numbers(each) for each in operands])
            case _:
                name = str(term)
                if name not in self._columns:
                    return np.array(np.nan)
                signal = self._signals.get(name) or _GrowingSignal(name)
                return signal.numbers(self._columns[name])

    def columns(self, term: Term) -> dict[str, Sequence[Any]]:
        """Return the values of the features of a term; None where one is missing."""
        missing = [None] * len(self.times)
        found = {str(each): self._columns.get(str(each), missing) for each in features_of(term)}
        return {
            name: each.tolist() if isinstance(each, np.ndarray) else each
            for name, each in found.items()
        }


@dataclass(eq=False)
class _GrowingSignal:
    """A signal in bounded memory: long ones keep the extremes of each span of time."""

    name: str
    window: int | None = None
    lines: int = 1
    times: Times = field(default_factory=lambda: np.empty(0, np.int64))
    values: Numbers = field(init=False)
    width: int = 1
    words: dict[str, int] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.values = np.empty((0, self.lines))

    def numbers(self, column: Column) -> Numbers:
        """Return values as numbers; texts are numbered in the order of their first uses."""
        array = np.asarray(column)
        if array.dtype.kind == 'b' and not self.words:
            self.words = {'false': 0, 'true': 1}
        if array.dtype.kind in 'biuf':
            return array.astype(np.float64)
        return np.array([self._number(each) for each in column], np.float64)

    def add(self, times: Times, values: Numbers) -> None:
        """Add the values of some states, with the ends of a band: a row for each."""
        self.times = np.concatenate([self.times, times])
        self.values = np.concatenate([self.values, values])
        if self.window is not None:
            first = np.searchsorted(self.times, self.times[-1] - self.window)
            self.times, self.values = self.times[first:], self.values[first:]
        if len(self.times) > MAX_POINTS * self.lines:
            self._thin_out()

    def miss(self, time: int) -> None:
        """Add a missing value, which interrupts the lines."""
        self.add(np.array([time], np.int64), np.full((1, self.lines), np.nan))

    def signal(self) -> Signal:
        """Return the signal so far."""
        values, *band = self.values.T
        ends = (band[0], band[1]) if band else None
        return Signal(self.name, self.times, values, tuple(self.words), ends)

    def _number(self, value: Any) -> float:
        if value is None or isinstance(value, int | float):
            return np.nan if value is None else float(value)
        word = str(value)
        if word not in self.words and len(self.words) > _MAX_WORDS:
            word = '(another)'
        return self.words.setdefault(word, len(self.words))

    def _thin_out(self) -> None:
        spans = self.times // self.width
        while spans[-1] - spans[0] >= MAX_SPANS:
            self.width *= 2
            spans = self.times // self.width
        kept = np.unique(np.concatenate([extremes(spans, each) for each in self.values.T]))
        self.times, self.values = self.times[kept], self.values[kept]


def extremes(spans: Times, values: Numbers) -> npt.NDArray[np.intp]:
    """Return the indices of the points that show a signal.

    These are the first, the last, a least and a greatest value of each span, and a missing one.

    Args:
        spans: the number of the span of each point, in order.
        values: NaN where one is missing.
    """
    is_missing = np.isnan(values)
    known, missing = np.flatnonzero(~is_missing), np.flatnonzero(is_missing)
    _, first_missing = np.unique(spans[missing], return_index=True)
    ends = [missing[first_missing]]
    if len(known):
        order = np.lexsort((values[known], spans[known]))
        starts = np.flatnonzero(np.diff(spans[known], prepend=spans[known[0]] - 1))
        stops = np.append(starts[1:], len(known)) - 1
        ends += [known[starts], known[stops], known[order[starts]], known[order[stops]]]
    return np.unique(np.concatenate(ends))
