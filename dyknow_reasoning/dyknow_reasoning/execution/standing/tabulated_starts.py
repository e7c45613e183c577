"""The open starts of all instances of a formula, progressed by look-ups where that is faster.

Steps of `OpenStarts` are only necessary at states that change something. Look-ups are faster if
that is often the case, if states come at a fixed period, and if few look-ups are new.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from math import inf
from typing import Final

from dyknow_reasoning.execution.automata.templates import Template
from dyknow_reasoning.execution.fast_path import LookUps, Step, look_ups_of
from dyknow_reasoning.execution.standing.joint_reader import predicates_of
from dyknow_reasoning.execution.standing.joint_table import (
    MAX_AGE,
    JointRow,
    JointTable,
    has_position,
)
from dyknow_reasoning.execution.standing.open_starts import OpenStarts
from dyknow_reasoning.execution.standing.runs import StateTimes

_FEWEST_STATES: Final = 64
_MOST_STATES: Final = 1 << 18
"""The states between attempts to use look-ups."""
_LEARNED: Final = 256
"""The look-ups that may be new in each attempt, even if that is slower."""
_NEW_COST: Final = 8
"""A look-up that is new costs as much as this many steps."""
_LOOK_UPS: Final = 128
"""So many look-ups cost as much as one step."""
_JOINING_LOOK_UPS: Final = 8
"""So many look-ups cost as much as a state that needs no step."""


class TabulatedStarts:
    """Progresses all instances by look-ups while `is_active`.

    Args:
        starts: of the instances; they are up to date unless `is_active`, and after `restore`.
        times: the valid times of the states.
        node_limit: of the automata: larger formulas are left to the starts.
    """

    def __init__(self, starts: Sequence[OpenStarts], times: StateTimes, node_limit: int) -> None:
        self.is_active = False
        self.quick_step: Step | None = None
        """Does the same as `step`, given the values of a state; False if a look-up is new."""
        self._starts = starts
        self._times = times
        self._node_limit = node_limit
        self._period = 0
        # The time of the latest state while active, and the rows after it; `synchronize` first.
        self._latest = 0
        self._rows: Sequence[JointRow] = ()
        self._tables: dict[Template, JointTable] = {}
        # Since state `_since`: the steps, or the look-ups that were new.
        self._since = self._events = 0
        self._wait = _FEWEST_STATES
        # No table holds what past operators remember.
        uses_tables = not any(each.instance.node.looks_back for each in starts)
        self._next_attempt: float = _FEWEST_STATES if uses_tables else inf
        # True if look-ups are also faster than states that need no step.
        self._is_small = uses_tables and 0 < len(starts) < _JOINING_LOOK_UPS
        # The steps for a state without look-ups.
        self._steps = 0.0

    def step(self, now: int, symbols: Sequence[int]) -> bool:
        """Progress over a state; return False, without effect, if it needs more than look-ups.

        Args:
            now: the valid time of the state, in nanoseconds, which is appended to the times.
            symbols: the truth of the atoms of each instance.
        """
        self.synchronize()
        self.quick_step = None
        if now - self._latest != self._period:
            return False
        try:
            self._rows = [row[symbol] for row, symbol in zip(self._rows, symbols)]  # noqa: B905
        except KeyError:
            if not self._extend(symbols):
                return False
        self._times.append(now)
        self._latest = now
        return True

    def generate(self) -> None:
        """Use `quick_step` from the next state on, if there can be one."""
        if self._look_ups:
            self._look_ups.enter(self._latest, self._period, *self._rows)
            self.quick_step = self._look_ups.step

    def synchronize(self) -> None:
        """Append the times of the states that `quick_step` took, as far as they are needed."""
        if self.quick_step and self._look_ups:
            latest, self._rows = self._look_ups.position()
            states = (latest - self._latest) // self._period
            self._times.repeat(self._period, states, kept=MAX_AGE + 1)
            self._latest = latest

    def restore(self) -> None:
        """Bring the starts up to date."""
        if not self.is_active:
            return
        self.synchronize()
        number = len(self._times) - 1
        for starts, row in zip(self._starts, self._rows, strict=True):
            table = self._tables[starts.template]
            table.restore(row, starts, number, self._times[number])

    def leave(self, *, is_expensive: bool = True) -> None:
        """Bring the starts up to date, which take the next states.

        Args:
            is_expensive: False to try look-ups again after the next state.
        """
        self.restore()
        self.is_active, self.quick_step = False, None
        states = len(self._times) - self._since
        if self._events * _NEW_COST <= self._steps * states:
            self._wait = _FEWEST_STATES  # The attempt was worthwhile.
        elif is_expensive:
            self._wait = min(4 * self._wait, _MOST_STATES)
        self._since, self._events = len(self._times), 0
        self._next_attempt = self._since + (self._wait if is_expensive else 0)

    def forget(self) -> None:
        """Forget all look-ups."""
        self._tables = {}

    def stepped(self, steps: int) -> float:
        """Use look-ups from the next state on if they are possible, and probably faster.

        Args:
            steps: how many steps the latest state took.

        Returns:
            The time by which it should be called again even if no state needs a step.
        """
        self._events += steps
        number = len(self._times) - 1
        if number >= self._next_attempt:
            states = number + 1 - self._since
            if states >= _FEWEST_STATES:
                self._steps = self._events / states
            self._since, self._events = number + 1, 0
            self._next_attempt = self._since + self._wait
            if self._is_small or self._steps * _LOOK_UPS > len(self._starts):
                self._enter(number)
        if self.is_active or not self._is_small:
            return inf
        now = self._times[number]
        period = now - self._times[number - 1] if number else 0
        return now + (self._next_attempt - number) * period

    @cached_property
    def _look_ups(self) -> LookUps[JointRow] | None:
        instances = [each.instance for each in self._starts]
        return look_ups_of([(each, predicates_of(each)) for each in instances])

    def _enter(self, number: int) -> None:
        now = self._times[number]
        period = now - self._times[number - 1]
        for each in self._starts:
            each.join(number + 1)
        if not all(has_position(each, number) for each in self._starts):
            return
        first = min(each.oldest(own=True) for each in self._starts)
        if any(self._times[n] - self._times[n - 1] != period for n in range(first + 1, number)):
            return
        if period != self._period or any(table.is_full for table in self._tables.values()):
            self._tables, self._period = {}, period
        rows: list[JointRow] = []
        for starts in self._starts:
            if starts.template not in self._tables:
                self._tables[starts.template] = JointTable(starts, period)
            row = self._tables[starts.template].row(starts, number, now)
            if row is None:
                return
            rows.append(row)
        self._rows = rows
        self._latest = now
        self.is_active = True

    def _extend(self, symbols: Sequence[int]) -> bool:
        """Progress over a state with new look-ups."""
        rows: list[JointRow] = []
        for starts, row, symbol in zip(self._starts, self._rows, symbols, strict=True):
            table = self._tables[starts.template]
            after = row.get(symbol)
            if after is None:
                self._events += 1
                after = table.extend(row, symbol)
            if after is None or table.automaton.is_full:
                return False
            rows.append(after)
        states = len(self._times) - self._since
        is_full = any(table.is_full for table in self._tables.values())
        if is_full or (self._events - _LEARNED) * _NEW_COST > self._steps * states:
            return False
        if any(each.automaton.max_size > self._node_limit for each in self._tables.values()):
            return False
        self._rows = rows
        return True
