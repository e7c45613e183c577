"""Runs of consecutive states, by their numbers and valid times."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Sequence
from itertools import chain
from typing import NamedTuple


class Run(NamedTuple):
    """Consecutive states.

    Args:
        first: the number of the first one.
        last: the number of the last one.
        begin: the valid time of the first one, in nanoseconds.
        end: the valid time of the last one.
    """

    first: int
    last: int
    begin: int
    end: int

    def to(self, later: Run) -> Run:
        """Return the run up to the end of a later one that follows it."""
        return Run(self.first, later.last, self.begin, later.end)


def count_states(runs: Iterable[Run]) -> int:
    """Return the number of states of disjoint runs."""
    return sum(run.last - run.first + 1 for run in runs)


def union(some: Sequence[Run], others: Sequence[Run]) -> list[Run]:
    """Merge runs into the fewest runs, in order; each argument must be in order."""
    if not some or not others:
        return [*some, *others]
    if others[-1].last < some[0].first:
        some, others = others, some
    between = others[0].first - some[-1].last
    if between > 1:
        return [*some, *others]
    if between == 1:
        return [*some[:-1], some[-1].to(others[0]), *others[1:]]
    return coalesced(sorted((*some, *others)))


def union_of(runs: Iterable[Sequence[Run]]) -> list[Run]:
    """Return the states of all runs; each sequence is in order."""
    return coalesced(sorted(chain.from_iterable(runs)))


def add_latest(runs: list[Run], run: Run) -> None:
    """Add states that come after all others, in place."""
    if runs and runs[-1].last + 1 == run.first:
        runs[-1] = runs[-1].to(run)
    else:
        runs.append(run)


def number_in(runs: Sequence[Run], number: int) -> bool:
    """Return True if a state is in one of the runs, which must be in order."""
    at = bisect_left(runs, number, key=lambda run: run.last)
    return at < len(runs) and runs[at].first <= number


def difference(runs: Sequence[Run], others: Sequence[Run]) -> list[Run]:
    """Return the states of the first runs alone, with the times of the whole runs."""
    found: list[Run] = []
    for run in runs:
        first = run.first
        at = bisect_left(others, first, key=lambda other: other.last)
        while at < len(others) and others[at].first <= run.last:
            if others[at].first > first:
                found.append(run._replace(first=first, last=others[at].first - 1))
            first = others[at].last + 1
            at += 1
        if first <= run.last:
            found.append(run._replace(first=first))
    return found


def count_outside(runs: Sequence[Run], others: Sequence[Run]) -> int:
    """Return the number of states that are in the first runs alone; both are in order."""
    return count_states(union(runs, others)) - count_states(others)


def coalesced(runs: Iterable[Run]) -> list[Run]:
    """Merge runs, sorted by first state, into the fewest disjoint runs."""
    found: list[Run] = []
    for run in runs:
        if found and run.first <= found[-1].last + 1:
            if run.last > found[-1].last:
                found[-1] = found[-1].to(run)
        else:
            found.append(run)
    return found


class StateTimes:
    """The valid times of the latest states, by their numbers; the first state has number 0."""

    def __init__(self) -> None:
        self.kept: list[int] = []
        """The times that are not forgotten."""
        self._first = 0
        # Appends the valid time of the next state.
        self.append = self.kept.append

    def __len__(self) -> int:
        """The number of all states so far."""
        return self._first + len(self.kept)

    def __getitem__(self, number: int) -> int:
        return self.kept[number - self._first]

    def number_at(self, time: float) -> int:
        """Return the number of the first kept state that is valid at a time or later."""
        return self._first + bisect_left(self.kept, time)

    @property
    def latest(self) -> int | None:
        """The valid time of the latest state; None before the first."""
        return self.kept[-1] if self.kept else None

    def is_forgotten(self, number: int) -> bool:
        """Return True if the time of a state is not kept."""
        return number < self._first

    def forget(self, before: int) -> None:
        """Forget the times of the states before a number."""
        del self.kept[: max(before - self._first, 0)]
        self._first = max(self._first, before)


def split(runs: list[Run], time: float, times: StateTimes) -> tuple[list[Run], list[Run]]:
    """Split runs at a time into the states before it and the states from then on.

    Args:
        runs: the runs, in order.
        time: the time, in nanoseconds.
        times: the times of all states of the runs.
    """
    if not runs or runs[-1].end < time:
        return runs, []
    if runs[0].begin >= time:
        return [], runs
    at = bisect_left(runs, time, key=lambda run: run.end)
    older, younger = runs[:at], runs[at:]
    first = younger[0]
    if first.begin < time:
        number = times.number_at(time)
        older.append(Run(first.first, number - 1, first.begin, times[number - 1]))
        younger[0] = Run(number, first.last, times[number], first.end)
    return older, younger
