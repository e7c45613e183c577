"""Progression of individual instances over many states of a recording, one instance at a time.

An instance skips the states that change nothing: at which its location, with its clocks, stays the
same. Example, `always (p -> eventually[0, 2 s] q)` (see `automata.automaton`): location A skips to
the next state with p and without q; location B to the next one with q, or later than 2 s after its
clock. Where few states can be skipped, it looks up its configurations in their table instead.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from operator import length_hint

import numpy as np

from dyknow_reasoning.execution.automata.automaton import Decision, Guard, Location, Move, Times
from dyknow_reasoning.execution.automata.instance_states import InstanceVerdict
from dyknow_reasoning.execution.recorded_symbols import RecordedSymbols, SymbolSequence
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.execution.vectors.atom_vectors import Array

_MAX_LOOK_UPS = 2048
_FEW_STATES = 8
"""If fewer can be skipped on average, the table is faster."""
_NONE = frozenset[int]()
_MAX_SYMBOLS = 16
"""The most symbols for which the effect of a location with clocks is worked out together."""


class BlockProgression:
    """Progresses instances over the states of a block, which count from 0 here.

    Args:
        times: the valid times of all states of the recording, in nanoseconds.
        steps: for each, the nanoseconds since the previous one.
        symbols: the truth of the atoms at the states of the block.
    """

    def __init__(self, times: Array, steps: Array, symbols: RecordedSymbols) -> None:
        states = slice(symbols.states.start, symbols.states.stop)
        self._time_vector, self._step_vector = times[states], steps[states]
        self._symbols = symbols
        # The symbols that change nothing at a location without clocks, and when that was found out;
        # and at a location with clocks.
        self._idle: dict[Location, tuple[int, frozenset[int]]] = {}
        self._skips: dict[Location, _IdleSymbols] = {}
        self._verdicts: dict[int, list[InstanceVerdict]] = {}

    def progress(
        self, singles: Sequence[SingleInstance]
    ) -> tuple[int, list[SingleInstance], Mapping[int, Sequence[InstanceVerdict]]]:
        """Progress instances up to the end of the block, or until a template needs attention.

        Returns:
            The index of the next state in the recording, the same instances there, and the verdicts
            by the indices of their states.
        """
        before = [single.state for single in singles]
        states = self._symbols.states
        end = len(states)
        for single in singles:
            end = self._progress(single, end, is_repeated=False)
        if end < len(states):
            # Some instances were progressed further: all begin again, and go as far as one could.
            self._verdicts.clear()
            singles = list(map(SingleInstance, before))
            for single in singles:
                self._progress(single, end, is_repeated=True)
        found = {states[index]: self._verdicts[index] for index in sorted(self._verdicts)}
        return states.start + end, list(singles), found

    def _progress(self, single: SingleInstance, end: int, *, is_repeated: bool) -> int:
        """Progress an instance up to a state, its verdict, or the limits; return the new end."""
        sequence, mask = self._symbols.of(single), single.mask
        index, skipped = 0, float(_FEW_STATES)
        while index < end:
            if single.mask != mask:
                sequence, mask = self._symbols.of(single), single.mask
            before = index
            index = self._skip(single.location, single.clocks, sequence, index, end)
            skipped += (index - before - skipped) / 8
            is_dense = skipped < _FEW_STATES
            if is_dense and self._is_regular and single.template.uses_configurations:
                index = self._look_up(single, sequence, index, end)
            if index == end:
                break
            verdict = single.step(sequence.values[index], self._times[index], self._steps[index])
            if verdict:
                self._verdicts.setdefault(index, []).append(verdict)
            index += 1
            if not is_repeated and single.template.needs_attention:
                return index
            if verdict:
                break
        return end

    def _skip(
        self, location: Location, clocks: Times, sequence: SymbolSequence, index: int, end: int
    ) -> int:
        """Return the index of the next of some states that changes the location or the clocks."""
        if not location.clocks:
            count, known = self._idle.get(location, (-1, _NONE))
            if count != len(location.moves):
                moves = location.moves.items()
                known = frozenset(symbol for symbol, move in moves if _is_idle(move))
                self._idle[location] = len(location.moves), known
            return sequence.next_other(index, end, known) if known else index
        times = (*clocks, self._times[index])
        symbol = sequence.values[index]
        skip = self._skips.get(location)
        until = skip.until(times) if skip is not None and symbol in skip.symbols else None
        if until is None or skip is None:
            skip = _skip_at(location, symbol, times)
            until = None if skip is None else skip.until(times)
            if until is None or skip is None:
                return index
            self._skips[location] = skip
        found = sequence.next_other(index, end, skip.symbols)
        if self._times[found - 1] < until:
            return found
        return bisect_left(self._times, until, index, found)

    def _look_up(
        self, single: SingleInstance, sequence: SymbolSequence, index: int, end: int
    ) -> int:
        """Progress over some states by table look-ups alone; return the index of the next state."""
        at = bisect_left(self._irregular, index)
        stop = min(index + _MAX_LOOK_UPS, end, *self._irregular[at : at + 1])
        if stop <= index:
            return index
        latest = self._times[index] - self._steps[index]
        configurations, period = single.template.configurations, self._period
        ages = tuple(latest - time for time in single.clocks)
        row = configurations.at(single.location, ages).row(period)
        symbols = iter(sequence.values[index:stop])
        symbol = 0
        try:
            for symbol in symbols:
                row = row[symbol]
        except KeyError:
            stop -= length_hint(symbols) + 1
            configurations.step(row.configuration, symbol, period)
        if stop > index:
            latest, reached = self._times[stop - 1], row.configuration
            single.move_to(reached.location, tuple(latest - age for age in reached.ages))
        return stop

    @cached_property
    def _times(self) -> list[int]:
        found: list[int] = self._time_vector.tolist()
        return found

    @cached_property
    def _steps(self) -> list[int]:
        found: list[int] = self._step_vector.tolist()
        return found

    @cached_property
    def _period(self) -> int:
        """The step of time that most states have, if there is one."""
        return int(np.sort(self._step_vector)[len(self._step_vector) // 2])

    @cached_property
    def _irregular(self) -> list[int]:
        """The indices of the states that come after another step of time."""
        found: list[int] = np.flatnonzero(self._step_vector != self._period).tolist()
        return found

    @cached_property
    def _is_regular(self) -> bool:
        return 4 * len(self._irregular) < len(self._step_vector)


def _is_idle(decision: Decision | None) -> bool:
    """Return True for a move that changes neither the location nor the clocks."""
    return type(decision) is Move and decision.is_idle


@dataclass(frozen=True, slots=True)
class _IdleSymbols:
    """Symbols that change nothing at a location, as long as some answers about times hold.

    Args:
        symbols: the symbols.
        deadlines: clocks, and the nanoseconds after each at which an answer changes.
        answers: the other questions: two times, the difference to exceed, and the answer.
    """

    symbols: frozenset[int]
    deadlines: tuple[tuple[int, int], ...]
    answers: tuple[tuple[int, int, int, bool], ...]

    def until(self, times: Times) -> float | None:
        """Return the time until which they change nothing; None if they may do so at once."""
        for later, earlier, more_than, answer in self.answers:
            if (times[later] - times[earlier] > more_than) != answer:
                return None
        until = inf
        for clock, offset in self.deadlines:
            deadline = times[clock] + offset
            if deadline < until:
                until = deadline
        return until if until > times[-1] else None


def _skip_at(location: Location, symbol: int, times: Times) -> _IdleSymbols | None:
    """Return the symbols that change nothing, if the present one does not.

    Args:
        location: a location with clocks.
        symbol: the present one.
        times: the clocks, and the time of the state.
    """
    found = _answered(location.moves.get(symbol), times)
    if not _is_idle(found[0]):
        return None
    symbols, questions = [symbol], dict.fromkeys(found[1])
    if len(location.moves) <= _MAX_SYMBOLS:
        for other, decision in location.moves.items():
            move, asked = _answered(decision, times)
            if _is_idle(move):
                symbols.append(other)
                questions |= dict.fromkeys(asked)
    now = location.clocks
    deadlines, answers = [], []
    for later, earlier, more_than, answer in questions:
        if later == now and not answer:
            deadlines.append((earlier, more_than + 1))
        elif earlier == now and answer:
            deadlines.append((later, -more_than))
        else:
            answers.append((later, earlier, more_than, answer))
    return _IdleSymbols(frozenset(symbols), tuple(deadlines), tuple(answers))


def _answered(
    decision: Decision | None, times: Times
) -> tuple[Decision | None, list[tuple[int, int, int, bool]]]:
    """Return the move at some times, and the questions about these with their answers."""
    asked = []
    while type(decision) is Guard:
        later, earlier, more_than = decision.later, decision.earlier, decision.more_than
        answer = times[later] - times[earlier] > more_than
        asked.append((later, earlier, more_than, answer))
        decision = decision.yes if answer else decision.no
    return decision, asked
