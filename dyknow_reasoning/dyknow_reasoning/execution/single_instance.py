"""One instance that is progressed individually, not in a batch."""

from __future__ import annotations

from collections.abc import Mapping
from math import inf
from typing import Final

from dyknow_reasoning.execution.automata.automaton import Location, Move, Times, wake_time
from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.execution.automata.instance_states import (
    DecidingMoment,
    InstanceState,
    InstanceVerdict,
)
from dyknow_reasoning.execution.automata.readers import Reader, quick_reader
from dyknow_reasoning.execution.kept_values import KeptReader
from dyknow_reasoning.progression.nodes import Sides

_MOST_IDLE: Final = 16
"""The most truths of the atoms that are known to change nothing."""


class SingleInstance:
    """An undecided instance, at a location with clocks.

    `read` returns the truth of the atoms in `mask`, on which the instance depends now. A state
    before `wakes_at` changes nothing if this truth is one of `idle`.
    """

    __slots__ = (
        '_kept',
        '_origins',
        '_readers',
        'clocks',
        'idle',
        'instance',
        'location',
        'mask',
        'read',
        'template',
        'wakes_at',
    )

    def __init__(self, state: InstanceState) -> None:
        self.instance = state.instance
        self.template: Template = state.template
        self.mask: int
        self.read: Reader
        self.idle: frozenset[int] = frozenset()
        self.wakes_at = -inf
        self.location = state.location
        self.clocks: Times = state.times
        self._origins: Mapping[Sides, int] = state.window_origins
        self._readers: dict[int, Reader] = {}
        self._kept: KeptReader | None = None
        if self.instance.keeps_values:
            self._kept = KeptReader(self.instance, self.template, lambda: [self.location.node])
        self._read_for(self.location)

    @property
    def state(self) -> InstanceState:
        """The state of the instance."""
        place = self.location, self.clocks
        return InstanceState(self.instance, self.template, *place, self._origins)

    def move_to(self, location: Location, clocks: Times) -> None:
        """Move to a location that depends on the same atoms, with the same open windows."""
        self.location, self.clocks, self.wakes_at = location, clocks, -inf

    def step(self, symbol: int, now: int, elapsed: int) -> InstanceVerdict | None:
        """Progress the instance over a state; return the verdict, if there is one.

        Args:
            symbol: the truth of the atoms in `mask`, as bits.
            now: the valid time of the state, in nanoseconds.
            elapsed: nanoseconds since the previous state.
        """
        if now < self.wakes_at and symbol in self.idle:
            return None
        times = (*self.clocks, now)
        location = self.location
        move = location.moves.get(symbol)
        if type(move) is not Move:
            move = self.template.automaton.move(location, symbol, times)
        if move.is_idle:
            self._rest(symbol, now, wake_time(location, symbol, times))
            return None
        target = move.target
        if target.verdict is not None:
            previous = now - elapsed
            moment = DecidingMoment.of(self.state, symbol, now, previous)
            return InstanceVerdict(self.instance, target.verdict, moment)
        self.location, self.clocks = target, move.select(times)
        if move.is_alike:
            # Often the next state is like this one.
            self.idle = frozenset((symbol,))
            self.wakes_at = wake_time(target, symbol, (*self.clocks, now))
        else:
            self.wakes_at = -inf
            self._enter(target, location, now)
        return None

    def _rest(self, symbol: int, now: int, wakes_at: float) -> None:
        """Record that states before a time at which the atoms are like this change nothing."""
        if now >= self.wakes_at:
            self.idle, self.wakes_at = frozenset((symbol,)), wakes_at
        elif len(self.idle) < _MOST_IDLE:
            self.idle |= {symbol}
            self.wakes_at = min(self.wakes_at, wakes_at)

    def _enter(self, target: Location, location: Location, now: int) -> None:
        if target.node.mask != location.node.mask:
            self._read_for(target)
        if target.unbounded != location.unbounded or location.is_fresh:
            self._origins = {sides: self._origins.get(sides, now) for sides in target.unbounded}

    def _read_for(self, location: Location) -> None:
        """Set `read` and `mask` to the atoms that a location depends on."""
        if self._kept is not None:
            self.mask, self.read = -1, self._kept
            return
        self.mask = mask = location.node.mask
        if mask not in self._readers:
            instance = self.instance
            self._readers[mask] = quick_reader(instance.atoms, instance.kinds, mask)
        self.read = self._readers[mask]
