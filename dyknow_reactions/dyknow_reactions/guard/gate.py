"""The gate of a guard: open only while everything that it depends on is known to be well.

It is closed at the start, and opens when each formula has a state that is not too old and from
which it holds, and each node of DyKnow has given a recent sign of life. With a timeout of 300 ms:

    time      event                               gate
      0 ms    start                               closed: no state has come
     50 ms    the nodes give signs of life        closed
    100 ms    a state, the formula holds          open
    200 ms    a state, the formula does not hold  closed: Ahead[rover] is 0.2
    250 ms    a state, the formula holds          open; with a latch, latched until `reset`
    551 ms    (no state has come since)           closed: the latest state is older than 300 ms
    700 ms    a state, the formula holds          closed: it comes 450 ms after its predecessor
    800 ms    a state, the formula holds          open

A state after a silence shows that its stream may have broken a constraint, whose violation is a
message on another topic. So the states must have gone on before the gate opens.

All times are of one monotonic clock, in nanoseconds. Each method first closes the gate if
something became too old before its time, so a latch does not depend on when it is looked at.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from enum import IntEnum
from typing import Final

from dyknow_common import NANOSECONDS, SECOND_NS, format_duration, round_duration

TOLERANCE_NS: Final = 100 * NANOSECONDS['ms']
"""The largest correction of the system clock between two looks."""

STEP_NS: Final = SECOND_NS
"""The largest advance of simulated time between two looks: a simulation may be fast."""


class GateState(IntEnum):
    """The state of a gate; numbers as in dyknow_interfaces/msg/GuardStatus."""

    OPEN = 0
    CLOSED = 1
    LATCHED = 2


@dataclass(slots=True)
class _Known:
    """The last sign of a formula or a node.

    Args:
        time: at which the latest state was valid, or of the latest sign of life; None if there is
            none that counts.
        failure: why a formula does not hold, or cannot be asked; empty if it holds.
        silence: the time between the latest two states, if it was longer than the timeout.
    """

    time: int | None = None
    failure: str = ''
    silence: int = 0


class Gate:
    """Decides whether messages pass.

    Args:
        formulas: the names of the formulas that must hold.
        nodes: the names of the nodes that must be alive.
        timeout: the longest time without a state of a formula, or a sign of life of a node.
        latch: True if the gate stays closed once it has closed, until it is reset.
        block: as of `block`, from the start on: a gate without formulas would open for an instant.
    """

    def __init__(
        self,
        formulas: Iterable[str],
        nodes: Iterable[str],
        timeout: int,
        *,
        latch: bool,
        block: str = '',
    ) -> None:
        self._formulas = {name: _Known() for name in formulas}
        self._nodes = {name: _Known() for name in nodes}
        self._timeout = timeout
        self._latch = latch
        self._block, self._interruption = block, ''
        self.state = GateState.CLOSED
        self._opened = 0
        self.reason = ''
        """Why it is closed; empty while it is open."""
        self.update(0)

    def note_state(self, formula: str, now: int, failure: str = '', *, age: int = 0) -> None:
        """Take a state of a formula.

        Args:
            formula: its name.
            now: the time.
            failure: why the formula does not hold; empty if it does.
            age: the time since the state was valid: one that has waited may be out of date.
        """
        self.update(now)
        time, predecessor = now - age, self._formulas[formula].time
        silence = 0 if predecessor is None else time - predecessor
        self._formulas[formula] = _Known(time, failure, silence if silence > self._timeout else 0)
        self.update(now)

    def note_fault(self, formula: str, now: int, reason: str) -> None:
        """Take the reason why a formula cannot be asked, until its next state."""
        self.update(now)
        self._formulas[formula] = _Known(None, reason)
        self.update(now)

    def note_node(self, node: str, now: int, *, age: int = 0) -> None:
        """Take a sign of life of a node, given the time since it was received."""
        self.update(now)
        self._nodes[node] = _Known(now - age)
        self.update(now)

    def interrupt(self, now: int, reason: str) -> None:
        """Forget what is known, as it may be out of date: all must be heard of again."""
        self.update(now)
        self._interruption = reason
        for known in (*self._formulas.values(), *self._nodes.values()):
            known.time = None
        self.update(now)

    def block(self, now: int, reason: str) -> None:
        """Close for a reason, until the method is called with an empty one."""
        self.update(now)
        self._block = reason
        self.update(now)

    def reset(self, now: int) -> bool:
        """Release the latch; return False if the gate must stay closed, for the present reason."""
        self.update(now)
        if self.state is GateState.LATCHED:
            obstacle = self._obstacle(now)
            if obstacle:
                self.reason = obstacle
                return False
            self.state = GateState.CLOSED
        self.update(now)
        return self.state is GateState.OPEN

    def passes(self, now: int, *, age: int = 0) -> bool:
        """Return True if a message may pass, given the time since it was received.

        One that was received while the gate was closed may not: it is out of date.
        """
        self.update(now)
        return self.state is GateState.OPEN and now - age >= self._opened

    def update(self, now: int) -> None:
        """Open or close according to what is known at a time."""
        if self.state is GateState.LATCHED:
            return
        obstacle = self._obstacle(now)
        if not obstacle:
            if self.state is not GateState.OPEN:
                self._opened = now
            self.state, self.reason, self._interruption = GateState.OPEN, '', ''
            return
        if self.state is GateState.OPEN and self._latch:
            self.state = GateState.LATCHED
        else:
            self.state = GateState.CLOSED
        self.reason = obstacle

    def _obstacle(self, now: int) -> str:
        """Return the first reason why no message may pass; empty if there is none."""
        if self._block:
            return self._block
        for name, known in self._formulas.items():
            if known.failure:
                return f'{name}: {known.failure}'
        for name, known in (*self._nodes.items(), *self._formulas.items()):
            what = 'sign of life' if name in self._nodes else 'state'
            if known.time is None:
                return self._interruption or f'{name}: no {what} has come'
            if now - known.time > self._timeout:
                return f'{name}: the latest {what} is older than {format_duration(self._timeout)}'
            if known.silence:
                distance = round_duration(known.silence)
                return f'{name}: the latest {what} comes {distance} after its predecessor'
        return ''


@dataclass(frozen=True, slots=True)
class GateReports:
    """Reports on formulas to a gate, at the times of the clocks of a guard.

    Args:
        gate: the gate.
        now: returns the monotonic time, in nanoseconds.
        age: returns the time that has passed since a valid time, at least 0.
        settle: called with the monotonic time after each report.
    """

    gate: Gate
    now: Callable[[], int]
    age: Callable[[int], int]
    settle: Callable[[int], None]

    def state(self, formula: str, valid_time: int, failure: str = '') -> None:
        """Report a state of a formula, and why it does not hold; empty if it does."""
        now = self.now()
        self.gate.note_state(formula, now, failure, age=self.age(valid_time))
        self.settle(now)

    def fault(self, formula: str, reason: str) -> None:
        """Report why a formula cannot be asked."""
        now = self.now()
        self.gate.note_fault(formula, now, reason)
        self.settle(now)


class ClockJumps:
    """Compares the time of a node with the monotonic time, each time that it is looked at."""

    def __init__(self) -> None:
        self._latest: tuple[int, int] | None = None

    def has_jumped(self, time: int, monotonic: int, *, is_simulated: bool) -> bool:
        """Return True if the time has jumped since the look before.

        Args:
            time: the time of the node, in nanoseconds.
            monotonic: the time of the monotonic clock, in nanoseconds.
            is_simulated: True if the node takes its time from /clock.
        """
        latest, self._latest = self._latest, (time, monotonic)
        if latest is None:
            return False
        advance, passed = time - latest[0], monotonic - latest[1]
        if is_simulated:
            # The first message of /clock sets the time, which is 0 until then.
            return latest[0] > 0 and not 0 <= advance <= max(STEP_NS, passed)
        return abs(advance - passed) > TOLERANCE_NS
