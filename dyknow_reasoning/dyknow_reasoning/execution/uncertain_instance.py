"""One instance that is progressed over states of which several may be the true ones.

It is at a set of configurations: a location of its automaton with clocks for each way to choose
among the alternatives of values so far. Ways that leave the same formula to satisfy are one
configuration, so the set stays small: what was uncertain is forgotten as soon as it makes no
difference any more.

Example, `always (p -> eventually[0, 2 s] q)` (A, and B with its obligation, as in `automaton`):

    state                   configurations
    0 s: p or not p, not q  A, B since 0 s
    1 s: not p, q           A
    2 s: p, not q           B since 2 s
    5 s: q or not q         false: in both cases it is too late
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final, NamedTuple

from dyknow_common import Alternatives, choices
from dyknow_reasoning.execution.automata.automaton import Location, Times
from dyknow_reasoning.execution.automata.configurations import Template
from dyknow_reasoning.execution.automata.instance_states import (
    DecidingMoment,
    InstanceState,
    InstanceVerdict,
)
from dyknow_reasoning.execution.automata.readers import Reader, quick_reader
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.instances import required_features

MAX_CONFIGURATIONS: Final = 256
"""The number of configurations of an instance; with more, its verdict is unknown."""


class UncertainVerdict(NamedTuple):
    """A verdict on an instance, and the values of the deciding state in one of the ways to it."""

    verdict: InstanceVerdict
    values: Values


class _Configuration(NamedTuple):
    """A location of the automaton, with clocks."""

    location: Location
    times: Times


class UncertainInstance:
    """An instance, at each of the configurations that are possible.

    Attributes:
        reason: why the latest configurations differ; empty if none ever did.
        is_unknown: True if so much is possible that the verdict is unknown.

    Args:
        state: of the instance, before the first state of which several are possible.
    """

    def __init__(self, state: InstanceState) -> None:
        self.reason, self.is_unknown = '', False
        self.instance = state.instance
        self._template = Template(state.template.automaton.initial.node)
        automaton, location = self._template.automaton, self._template.automaton.initial
        if not state.is_fresh:
            location = replace(state.location, moves={}, memories={})
            automaton.forget([location])
        self._possible = [_Configuration(location, state.times)]
        self._names = {str(each) for each in required_features([state.instance])}
        self._readers: dict[int, Reader] = {}
        self._verdicts: dict[bool, UncertainVerdict] = {}

    @property
    def verdicts(self) -> frozenset[bool | None]:
        """The verdicts that are possible now; None while undecided."""
        return frozenset(each.location.verdict for each in self._possible)

    @property
    def size(self) -> int:
        """The most nodes of what may remain of it."""
        return self._template.automaton.max_size

    def verdict(self, *, holds: bool) -> UncertainVerdict:
        """Return a verdict that has become possible, with the latest state that decided so."""
        return self._verdicts[holds]

    def states(self) -> list[InstanceState]:
        """Return the configurations that are not decided."""
        return [self._state(each) for each in self._possible if each.location.verdict is None]

    def progress(self, now: int, previous: int, values: Values) -> None:
        """Progress over a state.

        Args:
            now: its valid time, in nanoseconds.
            previous: that of the state before.
            values: the values of features, which may have alternatives.

        Raises:
            ReasoningError: for unusable values.
        """
        truths: dict[int, Mapping[int, Values]] = {}
        found: dict[_Configuration, None] = {}
        for before in self._possible:
            location, times = before
            if location.verdict is not None:
                found[before] = None
                continue
            mask = location.node.mask
            if mask not in truths:
                try:
                    truths[mask] = self._truths(values, mask)
                except ValueError:
                    self.is_unknown, self.reason = True, self._reason(values)
                    return
            after: dict[_Configuration, None] = {}
            for symbol, chosen in truths[mask].items():
                move = self._template.automaton.move(location, symbol, (*times, now))
                after[_Configuration(move.target, move.select((*times, now)))] = None
                if (holds := move.target.verdict) is not None:
                    moment = DecidingMoment(self._state(before), symbol, now, previous)
                    verdict = InstanceVerdict(self.instance, holds, moment)
                    self._verdicts[holds] = UncertainVerdict(verdict, chosen)
            if len(after) > 1:
                self.reason = self._reason(values)
            found.update(after)
        self._possible = list(found)
        self.is_unknown |= len(found) > MAX_CONFIGURATIONS
        if self._template.is_full:
            self._template.automaton.forget(each.location for each in self._possible)

    def _reason(self, values: Values) -> str:
        """Return why its values have alternatives; empty if they have none."""
        own = (values.get(name) for name in self._names)
        return next((each.reason for each in own if isinstance(each, Alternatives)), '')

    def _truths(self, values: Values, mask: int) -> Mapping[int, Values]:
        """Return the possible truths of the atoms of a mask, each with values that lead to it.

        Raises:
            ReasoningError: for unusable values.
            ValueError: for too many choices.
        """
        if mask not in self._readers:
            instance = self.instance
            self._readers[mask] = quick_reader(instance.atoms, instance.kinds, mask)
        read, found = self._readers[mask], dict[int, Values]()
        for each in choices({name: values[name] for name in self._names & values.keys()}):
            found.setdefault(read(each), {**values, **each})
        return found

    def _state(self, configuration: _Configuration) -> InstanceState:
        return InstanceState(self.instance, self._template, *configuration, {})
