"""Table-driven stepping of an instance's open starts, for periodic states.

A *joint position* is what `OpenStarts` holds, relative to the latest state: for each group its
location, the ages of its clocks, and its runs, by how many states ago they begin and end. At a
fixed period, the joint position and the truth of the atoms determine the next one, and which starts
are decided. So each step of `OpenStarts` is stored, and is a look-up from then on. Steps that make
the formula false from some start on are not stored.

Example, `p -> eventually[0, 5 s] q` with a state each second; location B waits for q:

    state             position
    p, not q          B (OWN): 0 to 0
    not p, not q      B (OWN): 1 to 1
    p, not q          B (OWN): 2 to 2, 0 to 0
    q                 nothing is open

Joint positions recur if few starts are open, or if signals repeat.
"""

from __future__ import annotations

from typing import Final, TypeAlias

from dyknow_reasoning.execution.automata.automaton import Location
from dyknow_reasoning.execution.standing.groups import OWN, Clocks, Group
from dyknow_reasoning.execution.standing.open_starts import OpenStarts
from dyknow_reasoning.execution.standing.runs import Run, StateTimes

MAX_AGE: Final = 2048
"""The most states ago that an open start of a joint position may be."""
_MAX_RUNS: Final = 12
"""The most runs of open starts; more of them hardly recur."""
_MAX_ROWS: Final = 1 << 13
"""The most joint positions."""
_MAX_STEPS: Final = 1 << 16
"""The most steps between them."""

JointPosition: TypeAlias = tuple[tuple[Location, Clocks, tuple[tuple[int, int], ...]], ...]


class JointRow(dict[int, 'JointRow']):
    """The next row for each truth of the atoms."""

    __slots__ = ('position',)

    def __init__(self, position: JointPosition) -> None:
        super().__init__()
        self.position = position


class JointTable:
    """The steps of the instances of one template.

    Args:
        starts: of one of the instances.
        period: the step of time between states, in nanoseconds.
    """

    def __init__(self, starts: OpenStarts, period: int) -> None:
        self.automaton = starts.template.automaton
        self._instance, self._template = starts.instance, starts.template
        self._period = period
        self._rows: dict[JointPosition, JointRow] = {}
        self._steps = 0

    @property
    def is_full(self) -> bool:
        """True if there are so many steps that it should be replaced."""
        return len(self._rows) >= _MAX_ROWS or self._steps >= _MAX_STEPS

    def row(self, starts: OpenStarts, number: int, now: int) -> JointRow | None:
        """Return the row of some starts; None if there can be none.

        Args:
            starts: have joined; all states since one from which a clock counts have the period.
            number: of the latest state.
            now: its valid time, in nanoseconds.
        """
        if not has_position(starts, number):
            return None
        groups = starts.groups.items()
        position = tuple(
            (
                group.location,
                _mirrored(group.clocks, now),
                tuple((number - run.first, number - run.last) for run in runs),
            )
            for group, runs in groups
        )
        if self._groups(position, number, now) != starts.groups:
            return None  # There was another step of time.
        found = self._rows.get(position)
        if found is None:
            found = self._rows[position] = JointRow(position)
        return found

    def restore(self, row: JointRow, starts: OpenStarts, number: int, now: int) -> None:
        """Set what some starts hold after a state, given by its number and its time."""
        starts.resume(self._groups(row.position, number, now))

    def extend(self, row: JointRow, symbol: int) -> JointRow | None:
        """Return the row after a state, and store it; None if the step is no look-up."""
        times = StateTimes()
        ages = [first for _, _, runs in row.position for first, _ in runs]
        number = max(ages, default=0)
        starts = OpenStarts(self._instance, self._template, times)
        times.extend(range(0, (number + 1) * self._period, self._period))
        self.restore(row, starts, number, number * self._period)
        now = (number + 1) * self._period
        times.append(now)
        decided = starts.step(symbol)
        if starts.fails_at_once or not all(each.holds for each in decided):
            return None
        found = self.row(starts, number + 1, now)
        if found is not None:
            row[symbol] = found
            self._steps += 1
        return found

    def _groups(self, position: JointPosition, number: int, now: int) -> dict[Group, list[Run]]:
        period = self._period
        return {
            Group(location, _mirrored(clocks, now)): [
                Run(number - first, number - last, now - first * period, now - last * period)
                for first, last in runs
            ]
            for location, clocks, runs in position
        }


def has_position(starts: OpenStarts, number: int) -> bool:
    """Return True if some starts, which have joined, are a joint position at a fixed period.

    Args:
        starts: the starts.
        number: of the latest state.
    """
    return (
        starts.run_count() <= _MAX_RUNS
        and number - starts.oldest(own=False) <= MAX_AGE
        and not any(group.after_gap for group in starts.groups)
    )


def _mirrored(clocks: Clocks, now: int) -> Clocks:
    """Return the ages of clocks at a time, or the clocks of such ages."""
    return tuple(OWN if clock is OWN else now - clock for clock in clocks)
