"""The states from which an instance of a formula is undecided, in the locations of its automaton.

Evaluations that begin at different states, but are at one location with the same clocks, have the
same future. They are one *group*: a location, its clocks, and the runs of their start states. A
clock that counts from the start state itself is `OWN`: its value differs from start to start, but
follows from the start. So a group moves as a whole, whatever its size. Only a guard with such a
clock splits it, at one point of its runs: the clocks of later starts are later.

Example, `p -> eventually[0, 5 s] q`, with a state each second:

    state              groups after it
    0: p, not q        B (OWN): 0
    1: not p, not q    B (OWN): 0          from 1 on, the formula is true at once
    2: p, not q        B (OWN): 0, 2
    3: p, not q        B (OWN): 0, 2-3
    6: p, not q        B (OWN): 2-3, 6     the guard `now - OWN > 5 s` splits off 0: false
    7: q                                   true from 2, 3, 6 and 7

While the truth of the atoms stays the same, and no guard changes its answer, further states leave
the groups as they are. A new state only joins the group of the latest start, or the formula is true
from it at once. Such states are only counted, until `wakes_at`.

Starts may also *fade* at some age: they leave their group for one and the same other group, and
stay in it, or the formula becomes true from them. States at which the oldest starts only fade are
counted, too. Example, `always[0, 1 s] eventually[0, 0.5 s] p`, while p is false since 7 s:

    age of a start    what remains
    less than 1 s     always[to start + 1 s] eventually[0, 0.5 s] p and eventually[to 7.5 s] p
    1 s or more       eventually[to 7.5 s] p

At each state, some start reaches the age of 1 s, but a step is necessary after 7.5 s only. The
counted states are processed together when somebody asks, or before the next step (`catch_up`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf
from typing import Final, TypeAlias

from dyknow_reasoning.execution.automata.automaton import Location, Move, Times
from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.execution.automata.instance_states import (
    DecidingMoment,
    FormulaInstance,
    InstanceState,
    InstanceVerdict,
)
from dyknow_reasoning.execution.automata.readers import Reader, quick_reader
from dyknow_reasoning.execution.kept_values import KeptReader
from dyknow_reasoning.execution.standing.groups import (
    OWN,
    Answers,
    DecidedStarts,
    Group,
    answers,
)
from dyknow_reasoning.execution.standing.runs import (
    Run,
    StateTimes,
    add_latest,
    number_in,
    split,
    union,
)
from dyknow_reasoning.progression.gaps import Gap, Half
from dyknow_reasoning.progression.nodes import Node, bounds_of
from dyknow_reasoning.progression.residual import growth_error

_MAX_KNOWN: Final = 4096
"""The most symbols (truths of all atoms) whose results are kept."""

_Fading: TypeAlias = tuple[int, Group]
"""An age in nanoseconds, and the group of the starts that reach it."""

_Rest: TypeAlias = tuple[float, _Fading | None]
"""The time until which a group needs no step, and which starts leave it before, if any do."""


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
        self.wakes_at: float = -inf
        """The time before which states with the same truth of the atoms need no `step`, ns."""
        self.fades_at: float = inf
        """The time at which the first start fades, in nanoseconds; see above."""
        self.can_fade = not instance.keeps_values
        """True if starts may fade."""
        self.groups: dict[Group, list[Run]] = {}
        """The starts; call `catch_up` before."""
        # The groups from which starts fade.
        self._fading: dict[Group, _Fading] = {}
        # For each symbol, the group that begins, and its `_rest`, from its oldest start.
        self._begun: dict[int, Group] = {}
        self._known: dict[int, _Rest] = {}
        self._times = times
        self._initial = Group(template.automaton.initial, ())
        self.symbol = -1
        """The truth of the atoms at the latest step, as bits; -1 if the next state needs one."""
        self.counted = len(times)
        """The number of states that have been progressed over."""
        # Where states go at which the atoms are as at the latest one, from number `counted` on.
        self._fresh = self._initial

    def reader(self) -> Reader:
        """Return a reader of the truth of the atoms at a state, for `step`."""
        instance = self.instance
        if instance.keeps_values:
            return KeptReader(instance, self.template, lambda: [instance.node, *self._nodes()])
        return quick_reader(instance.atoms, instance.kinds, instance.node.mask)

    def _nodes(self) -> list[Node]:
        return [location.node for location in self.locations]

    @property
    def locations(self) -> list[Location]:
        """The locations in use."""
        return [self._fresh.location, *(group.location for group in self.groups)]

    @property
    def beginning(self) -> InstanceState:
        """What remains from the next state on."""
        return self._state(self._initial, ())

    def runs(self, half: Half) -> Iterator[list[Run]]:
        """Yield the undecided start states of the groups of a half; call `catch_up` before."""
        return (runs for group, runs in self.groups.items() if group.half is half)

    def check_size(self, node_limit: int) -> None:
        """Check that no more than some nodes remain of the instance.

        Raises:
            ReasoningError: if more do.
        """
        largest = max((each.node for each in self.locations), key=lambda node: node.size)
        if largest.size > node_limit:
            raise growth_error(largest.size, node_limit, largest, self.instance.atoms)

    def run_count(self) -> int:
        """Return the number of runs that are kept."""
        return sum(map(len, self.groups.values()))

    def oldest(self, *, own: bool) -> int:
        """Return the number of the first undecided start, or of the next state.

        Args:
            own: True if starts count only if a clock counts from them.
        """
        groups = self.groups.items()
        firsts = (runs[0].first for group, runs in groups if not own or OWN in group.clocks)
        return min(firsts, default=self.counted)

    def has_open(self, number: int, *, pessimistic: bool) -> bool:
        """Return True if the formula is undecided from a state on.

        Args:
            number: the number of the state.
            pessimistic: True if the pessimistic halves after a gap count.
        """
        if number >= self.counted:
            return self._fresh.location.verdict is None
        return any(
            number_in(runs, number)
            for group, runs in self.groups.items()
            if pessimistic or group.half is not Half.PESSIMISTIC
        )

    def states(self, number: int) -> Iterator[InstanceState]:
        """Yield what remains of the formula from an undecided state on; call `catch_up` before."""
        for group, runs in self.groups.items():
            if number_in(runs, number):
                yield self._state(group, self._times_of(group, runs, number))

    def _times_of(self, group: Group, runs: Sequence[Run], number: int) -> Times:
        is_own = OWN in group.clocks
        return group.times_of(self._times[number] if is_own else runs[0].begin)

    def _state(self, group: Group, times: Times) -> InstanceState:
        instance = self.instance
        if group.after_gap:
            instance = replace(instance, half=group.half, gap=group.after_gap.gap)
        return InstanceState(instance, self.template, group.location, times, {})

    def catch_up(self, end: int) -> None:
        """Progress over the states before a number that needed no `step`, as if over the last."""
        first, self.counted = self.counted, end
        if end == first:
            return
        now = self._times[end - 1]
        if self._fresh.location.verdict is None:
            run = Run(first, end - 1, self._times[first], now)
            add_latest(self.groups.setdefault(self._fresh, []), run)
        if now < self.fades_at:
            return
        for group, (age, target) in self._fading.items():
            faded, left = split(self.groups.pop(group, []), now - age + 1, self._times)
            if left:
                self.groups[group] = left
            if faded and target.location.verdict is None:
                self._add(target, faded)

    def verdict(self, decided: DecidedStarts, run: Run) -> InstanceVerdict:
        """Return the verdict on the instance from the first state of a run on."""
        group, begin = decided.group, run.begin
        before = self._state(group, group.times_of(begin))
        if decided.symbol is None:
            return InstanceVerdict(before.instance, decided.holds, None)
        if not self.template.opens_windows_later:
            before = replace(before, window_origins=dict.fromkeys(group.location.unbounded, begin))
        number = len(self._times) - 1
        previous = self._times[number - 1] if run.first < number else 0
        moment = DecidingMoment.of(before, decided.symbol, self._times[number], previous)
        return InstanceVerdict(before.instance, decided.holds, moment)

    def resume(self, groups: dict[Group, list[Run]], states: int) -> None:
        """Set the starts that are undecided after some states; the next one needs a step."""
        self.groups = groups
        self.counted = states
        self.symbol = -1
        self.wakes_at = -inf
        self._fresh = self._initial
        self._begun, self._known = {}, {}

    def cross_gap(self, gap: Gap) -> list[DecidedStarts]:
        """Continue after a gap that follows the latest state; return the halves that it decides."""
        self.catch_up(len(self._times))
        before = self.groups
        self.resume({}, len(self._times))
        decided: list[DecidedStarts] = []
        for group, runs in before.items():
            for part in self._alike(group, runs, gap):
                times = group.times_of(part[0].begin)
                halves = self.template.automaton.halves(group.location, times, gap, past=0)
                for half in group.halves(gap, halves):
                    verdict = half.location.verdict
                    if verdict is None:
                        self._add(half, part)
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

    def step(self, symbol: int, number: int) -> list[DecidedStarts]:
        """Progress over a state.

        Args:
            symbol: the truth of the atoms of the formula at this state, as bits.
            number: the number of the state.

        Returns:
            The starts from which the state decides that the formula is false. If no start may fade,
            all starts that it decides, except the state itself if the formula is true from it on.
        """
        self.catch_up(number)
        now = self._times[number]
        self.symbol = symbol
        before, self.groups = self.groups, {}
        decided: list[DecidedStarts] = []
        for group, runs in before.items():
            self._move(group, runs, now, decided)
        self._begin(number, now)
        if self._fresh.location.verdict is False:
            run = Run(number, number, now, now)
            decided.append(DecidedStarts(self._initial, False, [run], symbol))
            self.wakes_at = -inf  # Each such state is recorded by itself.
        return decided

    def _move(self, group: Group, runs: list[Run], now: int, decided: list[DecidedStarts]) -> None:
        """Move the starts of a group over a state."""
        rest = runs
        while rest:
            move, (_, _, _, younger) = self._answers(group, rest[0].begin, now)
            part, rest = rest, []
            if younger <= part[-1].end:
                part, rest = split(part, younger, self._times)
            verdict = move.target.verdict
            if verdict is None:
                self._add(group if move.is_idle else group.moved(move, now), part)
            elif not (verdict and self.can_fade):
                decided.append(DecidedStarts(group, verdict, part, self.symbol))

    def _add(self, group: Group, runs: list[Run]) -> None:
        others = self.groups.get(group)
        self.groups[group] = union(others, runs) if others else runs

    def _answers(self, group: Group, begin: int, now: int) -> tuple[Move, Answers]:
        """Return the move of a start of a group, and the answers that lead to it."""
        location, symbol = group.location, self.symbol
        while True:
            found = answers(location.moves.get(symbol), group.clocks, begin, now)
            if type(found[0]) is Move:
                return found[0], found
            self.template.automaton.move(location, symbol, (*group.times_of(begin), now))

    def _begin(self, number: int, now: int) -> None:
        """Begin at the latest state, and find out which of the following ones need a step."""
        begun = self._begun.get(self.symbol)
        if begun is None:
            if len(self._begun) > _MAX_KNOWN:
                self._begun, self._known = {}, {}
            move = self.template.automaton.move(self._initial.location, self.symbol, (now,))
            begun = self._begun[self.symbol] = self._initial.moved(move, OWN)
        self._fresh = fresh = begun
        self.counted = number + 1
        if fresh.location.verdict is None:
            add_latest(self.groups.setdefault(fresh, []), Run(number, number, now, now))
        self.wakes_at = self.fades_at = inf
        self._fading.clear()
        for group, runs in self.groups.items():
            until, fading = self._rest(group, runs, now + 1)
            if until <= now:
                self.wakes_at = -inf
                return
            self.wakes_at = min(self.wakes_at, until)
            if fading:
                self._fading[group] = fading
                self.fades_at = min(self.fades_at, runs[0].begin + fading[0])
        for group, (_, target) in self._fading.items():
            if target in self._fading and self._oldest(group) < self._oldest(target):
                self.wakes_at = min(self.wakes_at, self.fades_at)  # Its starts are too old there.

    def _oldest(self, group: Group) -> int:
        return self.groups[group][0].begin

    def _rest(self, group: Group, runs: list[Run], now: int) -> _Rest:
        """Return how long states with the same truth of the atoms have no effect on a group.

        Args:
            group: the group.
            runs: its starts.
            now: the earliest time of the next state, in nanoseconds.
        """
        begin = runs[0].begin
        if group == self._fresh and (known := self._known.get(self.symbol)):
            lasts, fading = known
            if now - begin < (fading[0] if fading else lasts):
                return begin + lasts, fading
        until, decision, rest = inf, group.location.moves.get(self.symbol), runs
        while True:
            first = rest[0].begin
            move, end, age, younger = answers(decision, group.clocks, first, now)
            if type(move) is not Move or not move.is_idle:
                return -inf, None
            until = min(until, end)
            if younger > rest[-1].end:
                break
            until = min(until, first + age)
            _, rest = split(rest, younger, self._times)
        found: _Rest = min(until, first + age), None
        if self.can_fade and rest is runs and begin + age < until:
            found = self._fades(group, begin, age, until)
        if group == self._fresh:
            self._known[self.symbol] = found[0] - begin, found[1]
        return found

    def _fades(self, group: Group, begin: int, age: float, until: float) -> _Rest:
        """Do the same, as starts fade if all that reach an age stay in one other group then.

        Args:
            group: the group.
            begin: the valid time of its oldest start, in nanoseconds.
            age: below which starts stay in the group, in nanoseconds.
            until: the time before which they do.
        """
        while begin + age < until:
            time = begin + int(age)
            move, (_, end, later, _) = self._answers(group, begin, time)
            until = min(until, end)
            if not move.is_idle:
                break
            age = later
        else:
            return until, None
        if move.target.verdict is False or len(group.clocks) in move.kept:
            return time, None
        target = group.moved(move, time)
        until = self._moves_to(target, group, begin, later, until)
        if move.target.verdict is None:
            until = self._moves_to(target, target, begin, age + 1, until)
        return (until, (int(age), target)) if until > time else (time, None)

    def _moves_to(self, target: Group, group: Group, begin: int, age: float, until: float) -> float:
        """Return the time before which all starts of a group that reach an age move to another."""
        while begin + age < until:
            time = begin + int(age)
            move, (_, end, later, _) = self._answers(group, begin, time)
            if not (move.is_idle and group is target) and group.moved(move, time) != target:
                return time
            until, age = min(until, end), later
        return until


class RememberingStarts(OpenStarts):
    """The undecided start states of an instance with a past operator over a future operator.

    A state does not decide the operands of such an operator at once (see `progression`). Their
    remainders are the same for all start states, so they are progressed once for all. Each
    state begins at a location that is the formula with the memories of all states before it. So
    each state needs a step. Example, `p -> once[0, 2 s] eventually[0, 1 s] q` with a state each
    second. A memory lists state: remainder, and ev(5) is what remains of the operand,
    `eventually[to 5 s] q`:

        state                      memory after it         what remains from the state on
        0: not p, not q            0: ev(1)                true
        1: p, q                    0: true, 1: true        true
        2 and 3: not p, not q      1: true, 3: ev(4)       true
        4: p, not q                4: ev(5)                ev(5)

    Arguments as in `OpenStarts`.
    """

    def __init__(self, instance: FormulaInstance, template: Template, times: StateTimes) -> None:
        super().__init__(instance, template, times)
        # Where the next state begins.
        self._memory = self._initial

    @property
    def locations(self) -> list[Location]:
        """The locations in use."""
        return [self._memory.location, *super().locations]

    @property
    def beginning(self) -> InstanceState:
        """What remains from the next state on."""
        return self._state(self._memory, self._memory.times_of(0))

    def _begin(self, number: int, now: int) -> None:
        """Begin at the latest state; the memory of the next state includes it."""
        automaton, before = self.template.automaton, self._memory
        step = before.location, self.symbol, (*before.times_of(now), now)
        self._initial = before
        self._fresh = before.moved(automaton.move(*step), OWN)
        self._memory = before.moved(automaton.remember(*step), now)
        self.counted = number + 1
        self.wakes_at = -inf
        if self._fresh.location.verdict is None:
            add_latest(self.groups.setdefault(self._fresh, []), Run(number, number, now, now))


def open_starts(instance: FormulaInstance, template: Template, times: StateTimes) -> OpenStarts:
    """Return the undecided start states of an instance before the next state."""
    kind = RememberingStarts if instance.node.looks_back else OpenStarts
    return kind(instance, template, times)
