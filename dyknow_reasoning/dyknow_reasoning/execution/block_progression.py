"""Progression of individual instances over many states of a recording, one instance at a time.

An instance skips the states at which the truth of the atoms is known to change nothing, up to its
wake time. Example, `always (p -> eventually[0, 2 s] q)` (see `automata.automaton`): location A
skips to the next state with p and without q, location B to the next with q, or later than 2 s after
its clock. Where few states can be skipped, an instance looks up its configurations in their table.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Mapping, Sequence
from functools import cached_property
from operator import length_hint

import numpy as np

from dyknow_reasoning.execution.automata.instance_states import InstanceVerdict
from dyknow_reasoning.execution.recorded_symbols import RecordedSymbols, SymbolSequence
from dyknow_reasoning.execution.single_instance import SingleInstance
from dyknow_reasoning.execution.vectors.atom_vectors import Array

_MAX_LOOK_UPS = 2048
_FEW_STATES = 8
"""If fewer can be skipped on average, the table is faster."""
_PATIENCE = 64
"""The states after which the table is tried again, if it did not have the next step."""


class BlockProgression:
    """Progresses instances over the states of a block, which count from 0 here.

    Args:
        times: the valid times of all states of the recording, in nanoseconds.
        steps: for each state, the nanoseconds since the previous one.
        symbols: the truth of the atoms at the states of the block.
    """

    def __init__(self, times: Array, steps: Array, symbols: RecordedSymbols) -> None:
        states = slice(symbols.states.start, symbols.states.stop)
        self._time_vector, self._step_vector = times[states], steps[states]
        self._symbols = symbols
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
        index, skipped, look_up_from = 0, float(_FEW_STATES), 0
        while index < end:
            if single.mask != mask:
                sequence, mask = self._symbols.of(single), single.mask
            is_dense = skipped < _FEW_STATES and index >= look_up_from
            if is_dense and self._is_regular and single.template.uses_configurations:
                found = self._look_up(single, sequence, index, end)
                if found == end:
                    break
                # If it fails at once, perhaps each state leads to another configuration.
                look_up_from = index + _PATIENCE if found == index else 0
                index = found
            now = self._times[index]
            verdict = single.step(sequence.values[index], now, self._steps[index])
            if verdict:
                self._verdicts.setdefault(index, []).append(verdict)
            index += 1
            if not is_repeated and single.template.needs_attention:
                return index
            if verdict:
                break
            before = index
            if now < single.wakes_at and index < end:
                index = sequence.next_other(index, end, single.idle)
                if self._times[index - 1] >= single.wakes_at:
                    index = bisect_left(self._times, single.wakes_at, before, index)
            skipped += (index - before - skipped) / 8
        return end

    def _look_up(
        self, single: SingleInstance, sequence: SymbolSequence, index: int, end: int
    ) -> int:
        """Progress over some states by table look-ups alone; return the index of the next state."""
        at = bisect_left(self._irregular, index)
        stop = min(index + _MAX_LOOK_UPS, end, *self._irregular[at : at + 1])
        if stop <= index:
            return index
        latest = self._times[index] - self._steps[index]
        template, period = single.template, self._period
        ages = tuple(latest - time for time in single.clocks)
        row = template.at(single.location, ages).row(period)
        symbols = iter(sequence.values[index:stop])
        symbol = 0
        try:
            for symbol in symbols:
                row = row[symbol]
        except KeyError:
            stop -= length_hint(symbols) + 1
            template.step(row.configuration, symbol, period)
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
