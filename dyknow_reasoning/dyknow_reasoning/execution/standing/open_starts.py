"""The states from which an instance of a formula is undecided, in the locations of its automaton.

Evaluations that begin at different states and are at one location with the same clocks have the
same future. They are one *group*: a location, its clocks, and the runs of their start states. A
clock that counts from the start state itself is `OWN`: it differs from start to start, but is
known from the start. So a group moves as a whole, whatever its size. Only a guard with such a
clock splits it, at one point of its runs: the clocks of later starts are later.

Example, `p -> eventually[0, 5 s] q`, with a state each second:

    state              groups after it
    0: p, not q        B (OWN): 0
    1: not p, not q    B (OWN): 0          from 1 on, the formula is true at once
    2: p, not q        B (OWN): 0, 2
    3: p, not q        B (OWN): 0, 2-3
    6: p, not q        B (OWN): 2-3, 6     the guard `now - OWN > 5 s` splits off 0: false
    7: q                                   true from 2, 3, 6 and 7

While the truth of the atoms stays the same, and no guard changes its answer, each state does to the
groups what the one before did: nothing. Then the states only join the group of the latest start,
or are decided at once as the latest one was. `joins_until` and `shortest_step` tell as long as
which times this is so; such states need no call.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from math import inf
from typing import Final, NamedTuple, TypeAlias

from dyknow_reasoning.execution.automata.automaton import Decision, Guard, Location, Move, Times
from dyknow_reasoning.execution.automata.instance_states import (
    DecidingMoment,
    FormulaInstance,
    InstanceState,
    InstanceVerdict,
)
from dyknow_reasoning.execution.automata.templates import Template
from dyknow_reasoning.execution.standing.runs import (
    Run,
    StateTimes,
    add_latest,
    number_in,
    split,
    union,
)
from dyknow_reasoning.progression.gaps import Gap, Half
from dyknow_reasoning.progression.nodes import bounds_of

OWN: Final = None
"""The clock of a start state that counts from itself."""

Clocks: TypeAlias = tuple[int | None, ...]


class Group(NamedTuple):
    """Start states with one future, apart from their own clocks.

    Args:
        location: the location of the automaton.
        clocks: the times that bounds count from, in nanoseconds, or OWN.
        half: the half of the formula that it stands for after a gap.
        gap: the gap that its verdict depends on.
    """

    location: Location
    clocks: Clocks
    half: Half = Half.WHOLE

    gap: Gap | None = None

    def moved(self, move: Move, now: int | None) -> Group:
        """Return the group after a move; `now` is the time that a new clock has."""
        clocks = (*self.clocks, now)
        return self._replace(
            location=move.target, clocks=tuple(clocks[number] for number in move.kept)
        )

    def times_of(self, begin: int) -> Times:
        """Return the clocks of the start state that is valid at a time, in nanoseconds."""
        return tuple(begin if clock is OWN else clock for clock in self.clocks)

    def after_gap(self, gap: Gap, halves: tuple[Move, Move]) -> list[Group]:
        """Return the group itself if the gap has no effect, else one half or both.

        Args:
            gap: the gap.
            halves: the moves to the optimistic and the pessimistic half.
        """
        optimistic, pessimistic = halves
        if optimistic.target is pessimistic.target is self.location:
            return [self]
        moves = {Half.OPTIMISTIC: optimistic, Half.PESSIMISTIC: pessimistic}
        if self.half in moves:
            moves = {self.half: moves[self.half]}
        elif optimistic.target is pessimistic.target:
            moves = {self.half: optimistic}
        joined = self.gap.join(gap) if self.gap else gap
        return [
            self.moved(move, OWN)._replace(half=half, gap=joined) for half, move in moves.items()
        ]


@dataclass(frozen=True, slots=True)
class DecidedStarts:
    """Start states that are decided together.

    Args:
        group: before the deciding state.
        holds: the verdict, of the half of the group.
        runs: the start states.
        symbol: the truth of the atoms at the deciding state; None if a gap decides.
    """

    group: Group
    holds: bool
    runs: Sequence[Run]
    symbol: int | None


class _Part(NamedTuple):
    """A part of a group that makes the same move, and the times for which it is the same one."""

    runs: list[Run]
    move: Move
    until: float
    youngest: int


class OpenStarts:
    """The undecided start states of one instance.

    Args:
        instance: the instance.
        template: its template.
        times: the valid times of the states, shared by all instances.
    """

    def __init__(self, instance: FormulaInstance, template: Template, times: StateTimes) -> None:
        self.instance = instance
        self.template = template
        self.joins_until: float = -inf
        """The time before which states with the same truth of the atoms need no `step`, ns."""
        self.shortest_step = 0
        """The shortest time after the previous state for which this is so, in nanoseconds."""
        self._times = times
        self._groups: dict[Group, list[Run]] = {}
        # How long the groups stay the same, while the truth of the atoms does.
        self._idle: dict[Group, _Part] = {}
        self._initial = Group(template.automaton.initial, ())
        # Where states go at which the atoms are as at the latest one, from number `_joined` on.
        self._fresh = self._initial
        self._symbol = -1
        self._joined = len(times)

    @property
    def fails_at_once(self) -> bool:
        """True if the formula is false from the latest state on, and that state decides it."""
        return self._fresh.location.verdict is False

    @property
    def locations(self) -> list[Location]:
        """The locations in use."""
        return [self._fresh.location, *(group.location for group in self._groups)]

    def runs(self, half: Half) -> Iterator[list[Run]]:
        """Yield the undecided start states of the groups of a half; call `join` before."""
        return (runs for group, runs in self._groups.items() if group.half is half)

    def run_count(self) -> int:
        """Return the number of runs that are kept."""
        return sum(map(len, self._groups.values()))

    def oldest(self, *, own: bool) -> int:
        """Return the number of the first undecided start, or of the next state.

        Args:
            own: True if starts count only if a clock counts from them.
        """
        groups = self._groups.items()
        firsts = (runs[0].first for group, runs in groups if not own or OWN in group.clocks)
        return min(firsts, default=self._joined)

    def has_open(self, number: int, *, pessimistic: bool) -> bool:
        """Return True if the formula is undecided from a state on.

        Args:
            number: of the state.
            pessimistic: True if the pessimistic halves after a gap count.
        """
        if number >= self._joined:
            return self._fresh.location.verdict is None
        return any(
            number_in(runs, number)
            for group, runs in self._groups.items()
            if pessimistic or group.half is not Half.PESSIMISTIC
        )

    def join(self, end: int) -> None:
        """Let the states before a number join that needed no `step`."""
        first, self._joined = self._joined, end
        if end > first and self._fresh.location.verdict is None:
            run = Run(first, end - 1, self._times[first], self._times[end - 1])
            add_latest(self._groups.setdefault(self._fresh, []), run)

    def verdict(self, decided: DecidedStarts) -> InstanceVerdict:
        """Return the verdict on the instance from the first of some starts on."""
        group, begin = decided.group, decided.runs[0].begin
        instance = replace(self.instance, half=group.half, gap=group.gap)
        if decided.symbol is None:
            return InstanceVerdict(instance, decided.holds, None)
        number = len(self._times) - 1
        is_known = not self.template.opens_windows_later
        origins = dict.fromkeys(group.location.unbounded, begin) if is_known else {}
        before = InstanceState(
            instance, self.template, group.location, group.times_of(begin), origins
        )
        previous = self._times[number - 1] if decided.runs[0].first < number else 0
        moment = DecidingMoment(before, decided.symbol, self._times[number], previous)
        return InstanceVerdict(instance, decided.holds, moment)

    def begins(self) -> DecidedStarts:
        """Return the verdict on the latest state, for which `fails_at_once` is true."""
        number = len(self._times) - 1
        now = self._times[number]
        return DecidedStarts(self._initial, False, [Run(number, number, now, now)], self._symbol)

    def cross_gap(self, gap: Gap) -> list[DecidedStarts]:
        """Continue after a gap that follows the latest state; return the halves that it decides."""
        self.join(len(self._times))
        self._idle, self._symbol, self.joins_until = {}, -1, -inf
        self._fresh = self._initial
        before, self._groups = self._groups, {}
        decided: list[DecidedStarts] = []
        for group, runs in before.items():
            for part in self._alike(group, runs, gap):
                times = group.times_of(part[0].begin)
                halves = self.template.automaton.halves(group.location, times, gap)
                for half in group.after_gap(gap, halves):
                    verdict = half.location.verdict
                    if verdict is None:
                        self._keep_moved(half, part)
                    else:
                        decided.append(DecidedStarts(half, verdict, part, None))
        return decided

    def _alike(self, group: Group, runs: list[Run], gap: Gap) -> list[list[Run]]:
        """Split the starts of a group into parts on which a gap has one effect each."""
        if OWN not in group.clocks:
            return [runs]
        if len(group.clocks) > 1:
            return [
                [Run(number, number, self._times[number], self._times[number])]
                for run in runs
                for number in range(run.first, run.last + 1)
            ]
        offsets = {bound.offset for bound in bounds_of(group.location.node)}
        found, rest = [], runs
        for time in sorted(
            {edge - each for each in offsets for edge in (gap.after + 1, gap.before)}
        ):
            part, rest = split(rest, time, self._times)
            found.append(part)
        return [part for part in (*found, rest) if part]

    def step(self, symbol: int) -> list[DecidedStarts]:
        """Progress over the latest state, which has been appended to the times.

        Args:
            symbol: the truth of the atoms of the formula at this state, as bits.

        Returns:
            The starts that it decides, but for the state itself if that is decided at once.
        """
        number = len(self._times) - 1
        self.join(number)
        now = self._times[number]
        is_same = symbol == self._symbol
        self._symbol = symbol
        before, self._groups = self._groups, {}
        idle, self._idle = self._idle, {}
        decided: list[DecidedStarts] = []
        for group, runs in before.items():
            known = idle.get(group) if is_same else None
            if known and now < known.until and self._is_old(runs, now, known):
                self._keep(group, runs, known)
            else:
                self._move(group, runs, (symbol, now), decided)
        self._begin(number, now)
        return decided

    def _is_old(self, runs: Sequence[Run], now: int, known: _Part) -> bool:
        return now - runs[-1].end >= known.youngest

    def _begin(self, number: int, now: int) -> None:
        """Begin at the latest state, and find out how long the following ones do the same."""
        move = self.template.automaton.move(self._initial.location, self._symbol, (now,))
        self._fresh = fresh = self._initial.moved(move, OWN)
        self._joined = number
        until: float = inf
        self.shortest_step = 0
        if fresh.location.verdict is None:
            known = self._idle.get(fresh)
            if known is None:
                until = -inf
            else:
                self.shortest_step = known.youngest
        if len(self._idle) < len(self._groups):
            until = -inf
        self.joins_until = min([until, *(part.until for part in self._idle.values())])

    def _keep(self, group: Group, runs: list[Run], part: _Part) -> None:
        if group in self._groups:  # Others have moved here: how long they stay is unknown.
            self._groups[group] = union(self._groups[group], runs)
            self._idle.pop(group, None)
        else:
            self._groups[group] = runs
            self._idle[group] = part

    def _move(
        self,
        group: Group,
        runs: list[Run],
        state: tuple[int, int],
        decided: list[DecidedStarts],
    ) -> None:
        """Move the starts of a group; the state is its symbol and its valid time."""
        symbol, now = state
        parts = self._parts(group, runs, symbol, now)
        if len(parts) > 1:
            parts.sort(key=lambda part: part.runs[0].first)
        kept: _Part | None = None
        for part in parts:
            target = group.moved(part.move, now)
            verdict = target.location.verdict
            if verdict is not None:
                decided.append(DecidedStarts(group, verdict, part.runs, symbol))
            elif target != group:
                self._keep_moved(target, part.runs)
            elif kept is None:
                kept = part
            else:
                runs_of_both = union(kept.runs, part.runs)
                until = min(kept.until, part.until)
                kept = _Part(runs_of_both, part.move, until, part.youngest)
        if kept:
            self._keep(group, kept.runs, kept)

    def _keep_moved(self, group: Group, runs: list[Run]) -> None:
        found = self._groups.get(group)
        self._groups[group] = union(found, runs) if found else runs
        self._idle.pop(group, None)

    def _parts(self, group: Group, runs: list[Run], symbol: int, now: int) -> list[_Part]:
        """Split the starts of a group into parts that make one move each."""
        automaton, location = self.template.automaton, group.location
        found: list[_Part] = []
        pending = [runs]
        while pending:
            answers = _Answers(group, now, self._times, found)
            answers.follow(location.moves.get(symbol), pending.pop())
            for each in answers.unknown:
                automaton.move(location, symbol, (*group.times_of(each[0].begin), now))
                pending.append(each)
        return found


class _Answers:
    """Answers the guards of a group, and splits it where the answers differ."""

    def __init__(self, group: Group, now: int, times: StateTimes, found: list[_Part]) -> None:
        self.found = found
        self.unknown: list[list[Run]] = []
        """The starts for which the automaton has no move yet."""
        self._clocks = (*group.clocks, now)
        self._now = len(group.clocks)
        self._times = times

    def follow(
        self, decision: Decision | None, runs: list[Run], until: float = inf, youngest: int = 0
    ) -> None:
        """Follow the answers of some starts to their moves.

        Args:
            decision: the next guard, the move, or None if it is not known.
            runs: the starts, at least one.
            until: the time before which all answers so far stay the same, in nanoseconds.
            youngest: the least age of a start for which they are the same.
        """
        while type(decision) is Guard:
            later, earlier = self._clocks[decision.later], self._clocks[decision.earlier]
            if later is not OWN and earlier is not OWN:
                more_than = decision.more_than
                answer = later - earlier > more_than
                if decision.later == self._now and not answer:
                    until = min(until, earlier + more_than + 1)
                elif decision.earlier == self._now and answer:
                    until = min(until, later - more_than)
                decision = decision.yes if answer else decision.no
            elif later is not OWN:
                self._follow_earlier(decision, runs, (later, until, youngest))
                return
            else:
                assert earlier is not OWN  # noqa: S101 - clocks are of different states
                self._follow_later(decision, runs, (earlier, until, youngest))
                return
        if type(decision) is Move:
            self.found.append(_Part(runs, decision, until, youngest))
        else:
            self.unknown.append(runs)

    def _follow_earlier(self, guard: Guard, runs: list[Run], known: tuple[int, float, int]) -> None:
        """Follow the answers whether a time is more than some nanoseconds after the starts."""
        later, until, youngest = known
        is_now, more_than = guard.later == self._now, guard.more_than
        yes, no = split(runs, later - more_than, self._times)
        if yes:
            self.follow(guard.yes, yes, until, max(youngest, more_than + 1) if is_now else youngest)
        if no:
            ends = no[0].begin + more_than + 1 if is_now else inf
            self.follow(guard.no, no, min(until, ends), youngest)

    def _follow_later(self, guard: Guard, runs: list[Run], known: tuple[int, float, int]) -> None:
        """Follow the answers whether the starts are more than some nanoseconds after a time."""
        earlier, until, youngest = known
        is_now, more_than = guard.earlier == self._now, guard.more_than
        no, yes = split(runs, earlier + more_than + 1, self._times)
        if no:
            self.follow(guard.no, no, until, max(youngest, -more_than) if is_now else youngest)
        if yes:
            ends = yes[0].begin - more_than if is_now else inf
            self.follow(guard.yes, yes, min(until, ends), youngest)
