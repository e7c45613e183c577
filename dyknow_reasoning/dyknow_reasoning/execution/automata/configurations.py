"""What a formula can come to when states come at a few steps of time only, numbered.

Where the steps of time repeat, as in a stream with a sample period, the clocks of the automaton
take few values. A location with the values of its clocks is a *configuration*. From it, the truth
of the atoms and the step of time lead to one other configuration, by a look-up in a table that is
filled as needed.
"""

from __future__ import annotations

from dyknow_reasoning.execution.automata.automaton import Automaton, Location, Times

_MOST_CONFIGURATIONS = 1 << 14
_MOST_STEPS = 16


class Configuration:
    """A location and the ages of the states that its bounds count from.

    Args:
        number: its place in the list of configurations.
        location: what remains.
        ages: nanoseconds from those states to the latest one.
    """

    __slots__ = ('ages', 'location', 'number', 'rows')

    def __init__(self, number: int, location: Location, ages: Times) -> None:
        self.number = number
        self.location = location
        self.ages = ages
        self.rows: dict[int, Row] = {}

    def row(self, elapsed: int) -> Row:
        """The row of the table for a step of time, in nanoseconds."""
        found = self.rows.get(elapsed)
        if found is None:
            found = self.rows[elapsed] = Row(self)
        return found


class Row(dict[int, 'Row']):
    """The steps from a configuration after one step of time: for the truth of the atoms, a row.

    Only steps that go on with the same atoms and open no window without an end are kept: they need
    no more than the look-up.
    """

    __slots__ = ('configuration',)

    def __init__(self, configuration: Configuration) -> None:
        super().__init__()
        self.configuration = configuration


class Configurations:
    """The configurations of an automaton, as far as they have been reached.

    Args:
        automaton: finds the steps.
    """

    def __init__(self, automaton: Automaton) -> None:
        self.found: list[Configuration] = []
        self._automaton = automaton
        self._numbers: dict[tuple[Location, Times], Configuration] = {}
        self._steps: set[int] = set()

    @property
    def are_too_many(self) -> bool:
        """Whether the clocks take too many values."""
        return len(self.found) > _MOST_CONFIGURATIONS

    @property
    def is_full(self) -> bool:
        """Whether it is time to `forget`."""
        return self.are_too_many or len(self._steps) > _MOST_STEPS

    def at(self, location: Location, ages: Times) -> Configuration:
        """The configuration of a location and ages."""
        key = (location, ages)
        found = self._numbers.get(key)
        if found is None:
            found = self._numbers[key] = Configuration(len(self.found), location, ages)
            self.found.append(found)
            self._automaton.has_news = True
        return found

    def step(self, before: Configuration, symbol: int, elapsed: int) -> Configuration:
        """The configuration after a state.

        Args:
            before: that before the state.
            symbol: the truth of the atoms that the location depends on.
            elapsed: nanoseconds since the state before.
        """
        times = (*(-age - elapsed for age in before.ages), 0)
        location = before.location
        move = self._automaton.move(location, symbol, times)
        target = move.target
        after = self.at(target, tuple(-time for time in move.select(times)))
        if elapsed not in self._steps:
            self._steps.add(elapsed)
            self._automaton.has_news = True
        same_atoms = target.node.mask == location.node.mask
        begun = location is not self._automaton.initial
        same_windows = begun and target.unbounded == location.unbounded
        if same_atoms and same_windows and target.verdict is None:
            before.row(elapsed)[symbol] = after.row(elapsed)
        return after

    def forget(self) -> None:
        """Drops all configurations."""
        for each in self.found:
            each.rows.clear()
        self.found = []
        self._numbers = {}
        self._steps.clear()
