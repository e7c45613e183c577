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
or the formula is true from them at once. Such states need no call, until `wakes_at`. Nor do
states at which the only change is that the oldest starts leave their group for one and the same
other group, or that the formula becomes true from them: these starts *fade*, and are moved or
dropped later (see `fading`).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from math import inf
from typing import Final

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
from dyknow_reasoning.execution.standing.fading import Future
from dyknow_reasoning.execution.standing.groups import (
    ALWAYS,
    OWN,
    DecidedStarts,
    Group,
    Part,
    Validity,
    follow,
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
"""The most truths of the atoms for which results are kept."""


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
        self.reader = self._reader()
        """Returns the truth of the atoms at a state, for `step`."""
        self.wakes_at: float = -inf
        """The time before which states with the same truth of the atoms need no `step`, ns."""
        self.can_fade = not instance.keeps_values
        """True if `fades_at` may be later than the state that decides."""
        self.fades_at: float = inf
        """The time at which a start leaves its group in this way, in nanoseconds."""
        self._times = times
        self.groups: dict[Group, list[Run]] = {}
        """The starts; call `join` before."""
        # How long the groups stay the same, while the truth of the atoms does.
        self._idle: dict[Group, Validity] = {}
        self._initial = Group(template.automaton.initial, ())
        # Where states go at which the atoms are as at the latest one, from number `_joined` on.
        self._fresh = self._initial
        self._symbol = -1
        self._joined = len(times)
        # For each truth of the atoms, how long the group of the start state stays the same, with
        # times that count from its oldest start.
        self._known_validity: dict[int, Validity] = {}

    def _reader(self) -> Reader:
        instance = self.instance
        if instance.keeps_values:
            return KeptReader(instance, self.template, lambda: [instance.node, *self._nodes()])
        return quick_reader(instance.atoms, instance.kinds, instance.node.mask)

    def _nodes(self) -> list[Node]:
        return [location.node for location in self.locations]

    def forget(self) -> None:
        """Forget the results that are kept of the automaton; the next state needs a step."""
        self.join(len(self._times))
        self.resume(self.groups)
        self._known_validity.clear()

    @property
    def locations(self) -> list[Location]:
        """The locations in use."""
        return [self._fresh.location, *(group.location for group in self.groups)]

    @property
    def beginning(self) -> InstanceState:
        """What remains from the next state on."""
        return self._state(self._initial, ())

    def runs(self, half: Half) -> Iterator[list[Run]]:
        """Yield the undecided start states of the groups of a half; call `join` before."""
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
            for group, runs in self.groups.items()
            if pessimistic or group.half is not Half.PESSIMISTIC
        )

    def states(self, number: int) -> Iterator[InstanceState]:
        """Yield what remains of the formula from an undecided state on; call `join` before."""
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

    def join(self, end: int) -> None:
        """Let the states before a number join that needed no `step`, and move those that faded."""
        first, self._joined = self._joined, end
        if end == first:
            return
        if self._fresh.location.verdict is None:
            run = Run(first, end - 1, self._times[first], self._times[end - 1])
            add_latest(self.groups.setdefault(self._fresh, []), run)
        latest = self._times[end - 1]
        if latest < self.fades_at:
            return
        self.fades_at = inf
        for group, validity in list(self._idle.items()):
            runs = self._unfaded(self.groups[group], validity, latest)
            if runs:
                self.groups[group] = runs
                self.fades_at = min(self.fades_at, runs[0].begin + validity.fades)
            else:
                del self.groups[group], self._idle[group]

    def _unfaded(self, runs: list[Run], validity: Validity, now: int) -> list[Run]:
        """Return the starts that a state, like those before, leaves in their group."""
        successor = validity.successor
        if not successor:
            return runs
        faded, remaining = split(runs, now - int(validity.fades) + 1, self._times)
        if faded and successor.location.verdict is None:
            self._keep_idle(successor, faded, Validity(validity.until))
        return remaining

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

    def resume(self, groups: dict[Group, list[Run]]) -> None:
        """Set the starts that are undecided after the latest state."""
        self.groups = groups
        self._joined = len(self._times)
        self._idle, self._symbol = {}, -1
        self.wakes_at, self.fades_at = -inf, inf
        self._fresh = self._initial

    def cross_gap(self, gap: Gap) -> list[DecidedStarts]:
        """Continue after a gap that follows the latest state; return the halves that it decides."""
        self.join(len(self._times))
        before = self.groups
        self.resume({})
        decided: list[DecidedStarts] = []
        for group, runs in before.items():
            for part in self._alike(group, runs, gap):
                times = group.times_of(part[0].begin)
                halves = self.template.automaton.halves(group.location, times, gap, past=0)
                for half in group.halves(gap, halves):
                    verdict = half.location.verdict
                    if verdict is None:
                        self._keep(half, part)
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
            The starts that it decides, but for the state itself if the formula is true from it on.
        """
        number = len(self._times) - 1
        self.join(number)
        now = self._times[number]
        is_same = symbol == self._symbol
        self._symbol = symbol
        before, self.groups = self.groups, {}
        idle, self._idle = self._idle, {}
        decided: list[DecidedStarts] = []
        for group, runs in before.items():
            known = idle.get(group) if is_same else None
            if known and now < known.until:
                remaining = self._unfaded(runs, known, now)
                if remaining:
                    self._keep_idle(group, remaining, known)
            else:
                self._move(group, runs, now, decided)
        self._begin(number, now)
        if self._fresh.location.verdict is False:
            run = Run(number, number, now, now)
            decided.append(DecidedStarts(self._initial, False, [run], symbol))
            self.wakes_at = -inf  # Each such state is recorded by itself.
        return decided

    def _move(self, group: Group, runs: list[Run], now: int, decided: list[DecidedStarts]) -> None:
        """Move the starts of a group over a state."""
        for part, move in self._parts(group, runs, now):
            target = group.moved(move, now)
            verdict = target.location.verdict
            if verdict is None:
                self._keep(target, part)
            else:
                decided.append(DecidedStarts(group, verdict, part, self._symbol))

    def _begin(self, number: int, now: int) -> None:
        """Begin at the latest state, and find out how long the following ones do the same."""
        if len(self._known_validity) > _MAX_KNOWN:
            self._known_validity.clear()
        move = self.template.automaton.move(self._initial.location, self._symbol, (now,))
        self._fresh = fresh = self._initial.moved(move, OWN)
        self._joined = number + 1
        self.fades_at = self.wakes_at = inf
        if fresh.location.verdict is None:
            add_latest(self.groups.setdefault(fresh, []), Run(number, number, now, now))
        idle = self._idle
        for group, runs in self.groups.items():
            validity = idle.get(group) or self._validity(group, runs, now + 1)
            if validity is None:
                self.wakes_at = -inf
                return
            if validity is not ALWAYS:
                self.wakes_at = min(self.wakes_at, validity.until)
                self.fades_at = min(self.fades_at, runs[0].begin + validity.fades)
            idle[group] = validity

    def _validity(self, group: Group, runs: list[Run], now: int) -> Validity | None:
        """Return how long all starts of a group stay in it; None if that is not known.

        Args:
            group: the group.
            runs: its starts.
            now: the earliest time of the next state, in nanoseconds.
        """
        automaton, location, symbol = self.template.automaton, group.location, self._symbol
        begin = runs[0].begin
        if group == self._fresh and (known := self._known_validity.get(symbol)):
            until = begin + known.until
            if now < min(until, begin + known.fades):
                return Validity(until, known.fades, known.successor)
        decision = location.moves.get(symbol)
        if type(decision) is Move:
            return ALWAYS if group.stays(decision, now) else None
        parts = follow(Part(runs, decision), group.clocks, now, self._times)
        for _, move, _, _ in parts:
            if type(move) is not Move or not group.stays(move, now):
                return None
        if len(parts) > 1:
            return Validity(min(min(part.until, part.runs[0].begin + part.age) for part in parts))
        _, _, until, age = parts[0]
        found = None
        if begin + age < until and self.can_fade:
            found = Future(automaton, symbol, begin, now).fading(group, int(age), until)
        found = found or Validity(min(until, begin + age))
        if group == self._fresh:
            self._known_validity[symbol] = found._replace(until=found.until - begin)
        return found

    def _keep_idle(self, group: Group, runs: list[Run], validity: Validity) -> None:
        others = self.groups.get(group)
        self.groups[group] = union(others, runs) if others else runs
        if not others:
            self._idle[group] = validity
        elif known := self._idle.get(group):  # Else others have moved here.
            fading = known if known.successor else validity
            self._idle[group] = fading._replace(until=min(known.until, validity.until))

    def _keep(self, group: Group, runs: list[Run]) -> None:
        found = self.groups.get(group)
        self.groups[group] = union(found, runs) if found else runs
        self._idle.pop(group, None)

    def _parts(self, group: Group, runs: list[Run], now: int) -> list[tuple[list[Run], Move]]:
        """Split the starts of a group into parts that make one move each."""
        automaton, location, symbol = self.template.automaton, group.location, self._symbol
        decision = location.moves.get(symbol)
        if type(decision) is Move:
            return [(runs, decision)]
        while True:
            part = Part(runs, location.moves.get(symbol))
            parts = follow(part, group.clocks, now, self._times)
            known = [(runs, move) for runs, move, _, _ in parts if type(move) is Move]
            if len(known) == len(parts):
                return known
            for part in parts:
                automaton.move(location, symbol, (*group.times_of(part.runs[0].begin), now))


class RememberingStarts(OpenStarts):
    """The undecided start states of an instance in which a past operator is over a future one.

    A state does not decide the operands of such an operator at once (see `progression`). Their
    remainders are the same for all start states, so they are progressed once for all: each
    state begins at a location that is the formula with the memories of all states before it. So
    each state needs a step. Example, `p -> once[0, 2 s] eventually[0, 1 s] q` with a state each
    second, each number of a memory being that of a state, and ev(5) what remains of the operand,
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
        """Begin at the latest state, which the memory of the next one includes."""
        automaton, before = self.template.automaton, self._memory
        step = before.location, self._symbol, (*before.times_of(now), now)
        self._initial = before
        self._fresh = before.moved(automaton.move(*step), OWN)
        self._memory = before.moved(automaton.remember(*step), now)
        self._joined = number
        self.wakes_at, self.fades_at = -inf, inf
        self.join(number + 1)


def open_starts(instance: FormulaInstance, template: Template, times: StateTimes) -> OpenStarts:
    """Return the undecided start states of an instance before the next state."""
    kind = RememberingStarts if instance.node.looks_back else OpenStarts
    return kind(instance, template, times)
