"""All that the page shows, and the part of it that each page still lacks.

A page asks for what has changed when it is ready to receive it, so no page has a queue:

    page                                     board
    changes(view)                       ->   all formulas, and the streams if it shows them
    changes 0.2 s later                 ->   nothing
    changes after the next report       ->   all formulas
    changes with a formula opened       ->   its details and its drawing
    changes 0.2 s later                 ->   the points of the states since then
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Final

from dyknow_common import Value
from dyknow_coordinator import EvaluationStatus
from dyknow_dashboard.model.concepts import ConceptTable
from dyknow_dashboard.model.formulas import FormulaTable, MonitoredEvaluation
from dyknow_dashboard.model.health import HealthTable
from dyknow_dashboard.model.history import FailureHistory
from dyknow_dashboard.model.live_signals import LiveSignals
from dyknow_dashboard.model.requests import Interest
from dyknow_dashboard.model.streams import StreamTable, graph
from dyknow_dashboard.model.verdict_events import EventCounts, VerdictEvent, VerdictWatch

MAX_KEPT: Final = 100
"""The number of formulas whose signals are kept."""

MAX_KEPT_SIGNALS: Final = 2000
"""The number of signals of all formulas together: 100 MB."""

State = tuple[str, int, Mapping[str, Value]]
"""A state: its topic, its valid time in nanoseconds, and its fields."""


@dataclass(slots=True)
class _Shown:
    """The state of an opened formula on a page."""

    version: int = -1
    shape: tuple[Any, ...] | None = None
    latest: int = 0
    signals: LiveSignals | None = None


@dataclass(slots=True)
class PageState:
    """The state of a page: the versions of the tables, and the progress of its drawings.

    Args:
        interest: what it shows.
    """

    interest: Interest = field(default_factory=Interest)
    versions: dict[str, Any] = field(default_factory=dict)
    opened: dict[str, _Shown] = field(default_factory=dict)

    def show(self, interest: Interest) -> None:
        """Use what the page shows now."""
        self.interest = interest
        self.opened = {key: shown for key, shown in self.opened.items() if key in interest.opened}


class Board:
    """The state of the system, as the latest reports tell it.

    Args:
        clock: returns the present time, nanoseconds.
        history: the file that keeps failures; None keeps none.
    """

    def __init__(self, clock: Callable[[], int], history: Path | None = None) -> None:
        self.formulas = FormulaTable()
        self.streams = StreamTable()
        self.health = HealthTable()
        self.concepts = ConceptTable()
        self.counts = EventCounts()
        self.history = FailureHistory(history, clock, self.counts)
        self.sinks: list[Callable[[list[VerdictEvent]], None]] = [self.history.put]
        """Take each change of a verdict, and never wait."""
        self._watch = VerdictWatch(self.counts)
        self.clock = clock
        self.can_save = False
        """True if a black box recorder runs."""
        self._signals: dict[str, LiveSignals] = {}

    def report(self, statuses: Sequence[EvaluationStatus], now: int) -> None:
        """Take a report of the coordinator, of a time in nanoseconds on its clock."""
        self.formulas.update(statuses, now)
        if events := self._watch.update(statuses, self.clock()):
            for each in self.sinks:
                each(events)

    def state_topics(self, pages: Iterable[PageState]) -> set[str]:
        """Return the topics of the states that signals are kept of, and forget other signals.

        The signals of opened formulas come first, then those of failing, running and ended ones.
        """
        opened = (key for page in pages for key in page.interest.opened)
        kept: dict[str, LiveSignals] = {}
        room = MAX_KEPT_SIGNALS
        for key in list(dict.fromkeys((*opened, *self.formulas.keys())))[:MAX_KEPT]:
            signals = self._followed(key)
            if signals is not None and signals.count <= room:
                kept[key] = signals
                room -= signals.count
        self._signals = kept
        return {each.topic for each in kept.values() if not each.is_complete}

    def signals_of(self, key: str) -> LiveSignals | None:
        """Return the signals of an evaluation, if they are kept."""
        return self._signals.get(key)

    def add_states(self, states: Iterable[State]) -> None:
        """Add states to the signals of all formulas that use them."""
        users: dict[str, list[LiveSignals]] = {}
        for signals in self._signals.values():
            users.setdefault(signals.topic, []).append(signals)
        for topic, valid_time, fields in states:
            for signals in users.get(topic, ()):
                signals.add(valid_time, fields)

    def changes(self, page: PageState) -> Iterator[dict[str, Any]]:
        """Yield the messages that a page lacks, which it is then assumed to have."""
        for name, version, document in self._tables(page.interest.view):
            if page.versions.get(name) != version:
                page.versions[name] = version
                yield {'type': name, **document()}
        for key in page.interest.opened:
            evaluation = self.formulas.get(key)
            if evaluation is None:
                page.opened.pop(key, None)
            else:
                yield from self._details(page.opened.setdefault(key, _Shown()), evaluation)

    def _tables(self, view: str) -> Iterator[tuple[str, Any, Callable[[], dict[str, Any]]]]:
        formulas, streams = self.formulas, self.streams
        health = self.health
        yield (
            'formulas',
            (formulas.version, self.can_save),
            lambda: {**formulas.document(), 'can_save': self.can_save},
        )
        # A page tells at all times which nodes are missing.
        yield 'nodes', health.version, health.document
        yield 'history', self.history.state.version, lambda: asdict(self.history.state)
        both = streams.version, formulas.version
        if view == 'streams':
            yield 'streams', both, lambda: streams.document(formulas.running())
        elif view == 'graph':
            yield 'graph', both, lambda: graph(streams.reports, formulas.running())
        elif view == 'ontology':
            yield 'ontology', self.concepts.version, self.concepts.document

    def _details(self, shown: _Shown, evaluation: MonitoredEvaluation) -> Iterator[dict[str, Any]]:
        key, signals = evaluation.key, self.signals_of(evaluation.key)
        if shown.version != self.formulas.version:
            shown.version = self.formulas.version
            details = self.formulas.details(evaluation)
            yield {'type': 'details', 'id': key, **details}
            if signals is not None:
                signals.units = self.concepts.units
                signals.update()
        if signals is None:
            return
        if shown.signals is not signals or shown.shape != signals.shape:
            drawing = signals.drawing()
            shown.signals, shown.shape, shown.latest = signals, signals.shape, signals.latest
            yield {'type': 'drawing', 'id': key, **drawing}
        elif shown.latest != signals.latest:
            yield {'type': 'points', 'id': key, **signals.points(shown.latest)}
            shown.latest = signals.latest

    def _followed(self, key: str) -> LiveSignals | None:
        """Return the signals of an evaluation by its latest status; None without states."""
        evaluation, signals = self.formulas.get(key), self.signals_of(key)
        if evaluation is None:
            return None
        status, known = evaluation.status, self.concepts.domains
        if signals is not None:
            signals.follow(status, known)
        elif status.state_stream:
            signals = LiveSignals(status, known)
        return signals
