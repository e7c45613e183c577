"""Templates, and configurations: locations with the ages of their clocks, numbered.

Instances that differ only in their fields and constants share a template. If the steps of time
between states repeat, as in a stream with a sample period, clocks have few values. The truth of the
atoms and the step of time then lead from each configuration to exactly one other. The template
looks it up in a table, which is filled on demand.

Example, the automaton of `always (p -> eventually[0, 2 s] q)` (see `automaton`) with a state each
second; the age of clock c0 is in brackets:

    configuration    not p, not q    p, not q    q
    0: A             0               1           0
    1: B (0 s)       2               2           0
    2: B (1 s)       false           false       0

With a period of 1 ms, there are 2001 configurations.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import inf

from dyknow_reasoning.execution.automata.automaton import Automaton, Location, Times
from dyknow_reasoning.progression.nodes import Node, Window, descendants, operands

_MAX_CONFIGURATIONS = 1 << 14
_MAX_STEPS = 16
_MAX_ENTRIES = 1 << 18


@dataclass(eq=False, slots=True)
class Configuration:
    """A location and the ages of its clocks.

    Args:
        number: the index in the list of configurations.
        location: the location.
        ages: for each clock, the nanoseconds from its time to the latest state.
        rows: the row of the table for each step of time.
    """

    number: int
    location: Location
    ages: Times
    rows: dict[int, Row] = field(default_factory=dict)

    def row(self, elapsed: int) -> Row:
        """Return the row of the table for a step of time in nanoseconds."""
        found = self.rows.get(elapsed)
        if found is None:
            found = self.rows[elapsed] = Row(self)
        return found


class Row(dict[int, 'Row']):
    """A row of the table: the next row for each truth of the atoms, after one step of time.

    It holds only steps after which the instance depends on the same atoms and has the same open
    windows without an end. Such a step needs no more than the look-up.
    """

    __slots__ = ('configuration',)

    def __init__(self, configuration: Configuration) -> None:
        super().__init__()
        self.configuration = configuration


class Template:
    """The automaton of some instances, of one formula or of several, and its configurations.

    Attributes:
        found: the configurations that have been reached.
        uses_configurations: False once there are too many, for example as time steps do not repeat.
        opens_windows_later: True if a window without an end may open after the first state.
        safe_size: the most nodes of an instance for which the node limit need not be checked.
    """

    def __init__(self, formula: Node) -> None:
        self.automaton = Automaton(formula)
        self.found: list[Configuration] = []
        self.uses_configurations = True
        self.opens_windows_later = _nests_unbounded_window(formula)
        self.safe_size: float = inf
        self._numbers: dict[tuple[Location, Times], Configuration] = {}
        self._steps: set[int] = set()
        self._entries = 0

    @property
    def is_full(self) -> bool:
        """True if `forget` should be called."""
        has_many = len(self.found) > _MAX_CONFIGURATIONS or len(self._steps) > _MAX_STEPS
        return has_many or self._entries > _MAX_ENTRIES or self.automaton.is_full

    @property
    def is_large(self) -> bool:
        """True if an instance may be larger than `safe_size`."""
        return self.automaton.max_size > self.safe_size

    @property
    def needs_attention(self) -> bool:
        """True if it has grown, and a limit is to be checked before the next state."""
        return self.automaton.has_grown and (self.is_full or self.is_large)

    def at(self, location: Location, ages: Times) -> Configuration:
        """Return the configuration of a location and ages."""
        key = (location, ages)
        found = self._numbers.get(key)
        if found is None:
            found = self._numbers[key] = Configuration(len(self.found), location, ages)
            self.found.append(found)
            self.automaton.has_grown = True
        return found

    def step(self, before: Configuration, symbol: int, elapsed: int) -> Configuration:
        """Return the configuration after a state that comes `elapsed` ns after the previous one."""
        times = (*(-age - elapsed for age in before.ages), 0)
        move = self.automaton.move(before.location, symbol, times)
        after = self.at(move.target, tuple(-time for time in move.select(times)))
        if elapsed not in self._steps:
            self._steps.add(elapsed)
            self.automaton.has_grown = True
        if move.is_alike:
            before.row(elapsed)[symbol] = after.row(elapsed)
            self._entries += 1
            self.automaton.has_grown |= self._entries > _MAX_ENTRIES
        return after

    def forget(self, locations: Iterable[Location]) -> None:
        """Leave configurations, and drop the automaton but for some locations if it is full."""
        self.uses_configurations = False
        for configuration in self.found:
            configuration.rows.clear()  # Rows refer to each other.
        self.found, self._numbers, self._entries = [], {}, 0
        self._steps.clear()
        if self.automaton.is_full:
            self.automaton.forget(locations)


def _nests_unbounded_window(formula: Node) -> bool:
    found = descendants([formula])
    inner = descendants(side for each in found for side in operands(each))
    return any(type(each) is Window and each.end is None for each in inner)
