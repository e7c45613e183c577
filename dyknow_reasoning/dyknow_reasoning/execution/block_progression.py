"""Progression of individual instances over many states of a recording, one instance at a time.

An instance skips the states that change nothing: at which its location, with its clocks, stays the
same. Example, `always (p -> eventually[0, 2 s] q)` (see `automata.automaton`): location A skips to
the next state with p and without q; location B to the next one with q, or later than 2 s after its
clock. Where few states can be skipped, it looks up its configurations in their table instead.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from math import inf
from operator import length_hint

import numpy as np

from dyknow_reasoning.execution.automata.automaton import Decision, Guard, Location, Move, Times
from dyknow_reasoning.execution.automata.instance_states import InstanceVerdict
from dyknow_reasoning.execution.recorded_symbols import (
    Deadlines,
    Jump,
    RecordedSymbols,
    SymbolSequence,
)
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.execution.vectors.atom_vectors import Array

_MAX_LOOK_UPS = 2048
_FEW_STATES = 8
"""If fewer can be skipped on average, the table is faster."""
_NONE = frozenset[int]()
_NO_JUMP: Jump = (0,), ()
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
        latest = int(self._time_vector[0] - self._step_vector[0])
        before = [single.state(latest) for single in singles]
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
            if single.configuration:
                single.leave_configurations(self._times[index] - self._steps[index])
            index, skipped = self._follow(single, sequence, (index, end), skipped)
            if index == end:
                break
            before = index
            index = self._skip(single.location, single.clocks, sequence, index, end)
            skipped += (index - before - skipped) / 8
            is_dense = skipped < _FEW_STATES
            uses_table = is_dense and self._is_regular and single.template.uses_configurations
            if uses_table:
                index = self._look_up(single, sequence, index, end)
            if index == end:
                break
            elapsed, symbol = self._steps[index], sequence.values[index]
            regular = uses_table and elapsed == self._period
            verdict = single.step(symbol, self._times[index], elapsed, regular=regular)
            if verdict:
                self._verdicts.setdefault(index, []).append(verdict)
            index += 1
            if not is_repeated and single.template.needs_attention:
                return index
            if verdict:
                break
        return end

    def _follow(
        self,
        single: SingleInstance,
        sequence: SymbolSequence,
        states: tuple[int, int],
        skipped: float,
    ) -> tuple[int, float]:
        """Take known steps to locations with the same atoms, while many states are skipped between.

        All other steps are those of the slower `_progress`.

        Args:
            single: the instance, at a location.
            sequence: its symbols.
            states: the indices of the next state and of the end.
            skipped: the number of states that are skipped on average; it is returned, too.
        """
        index, end = states
        location, clocks = single.location, single.clocks
        times, values, jumps = self._times, sequence.values, sequence.jumps
        while index < end and skipped >= _FEW_STATES:
            before = index
            index = _end_of_jump(jumps.get(location, _NO_JUMP), clocks, times, (index, end))
            if index == before:
                index = self._skip(location, clocks, sequence, index, end)
            skipped += (index - before - skipped) / 8
            if index == end:
                break
            now = (*clocks, times[index])
            move = location.moves.get(values[index])
            while type(move) is Guard:
                answer = now[move.later] - now[move.earlier] > move.more_than
                move = move.yes if answer else move.no
            if type(move) is not Move or not move.is_alike:
                break
            location, clocks = move.target, move.select(now)
            index += 1
        single.location, single.clocks = location, clocks
        return index, skipped

    def _skip(
        self, location: Location, clocks: Times, sequence: SymbolSequence, index: int, end: int
    ) -> int:
        """Return the index of the next of some states that changes the location or the clocks."""
        if not location.clocks:
            count, known = self._idle.get(location, (-1, _NONE))
            if count != len(location.moves):
                moves = location.moves.items()
                known = frozenset(symbol for symbol, move in moves if _is_idle(move, location))
                self._idle[location] = len(location.moves), known
            if not known:
                return index
            sequence.keep_jump(location, known, ())
            return sequence.next_other(index, end, known)
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
        if not skip.answers:
            sequence.keep_jump(location, skip.symbols, skip.deadlines)
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
        row = single.enter_configurations(latest).row(self._period)
        symbols = iter(sequence.values[index:stop])
        try:
            for symbol in symbols:
                row = row[symbol]
        except KeyError:
            stop -= length_hint(symbols) + 1
        single.configuration = row.configuration
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


def _end_of_jump(jump: Jump, clocks: Times, times: Sequence[int], states: tuple[int, int]) -> int:
    """Return the index of the next state that may change a location; the first one in doubt.

    Args:
        jump: from the location.
        clocks: its clocks.
        times: the valid times of all states.
        states: the indices of the first state and of the end.
    """
    index, end = states
    edges, deadlines = jump
    at = bisect_right(edges, index)
    if at % 2:
        return index
    found = min(edges[at], end)
    for clock, offset in deadlines:
        if clocks[clock] + offset <= times[found - 1]:
            return index
    return found


def _is_idle(decision: Decision | None, location: Location) -> bool:
    """Return True for a move that changes neither the location nor the clocks."""
    if type(decision) is not Move or decision.target is not location:
        return False
    return not decision.kept or decision.kept[-1] < location.clocks


@dataclass(frozen=True, slots=True)
class _IdleSymbols:
    """Symbols that change nothing at a location, as long as some answers about times hold.

    Args:
        symbols: the symbols.
        deadlines: clocks, and the nanoseconds after each at which an answer changes.
        answers: the other questions: two times, the difference to exceed, and the answer.
    """

    symbols: frozenset[int]
    deadlines: Deadlines
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
    if not _is_idle(found[0], location):
        return None
    symbols, questions = [symbol], dict.fromkeys(found[1])
    if len(location.moves) <= _MAX_SYMBOLS:
        for other, decision in location.moves.items():
            move, asked = _answered(decision, times)
            if _is_idle(move, location):
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
