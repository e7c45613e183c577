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
from dyknow_configuration import NO_MAP, RobotMap
from dyknow_coordinator import EvaluationStatus
from dyknow_dashboard.model.formulas import FormulaTable, MonitoredEvaluation
from dyknow_dashboard.model.health import HealthTable
from dyknow_dashboard.model.history import FailureHistory
from dyknow_dashboard.model.live_map import LiveMap
from dyknow_dashboard.model.live_signals import LiveSignals
from dyknow_dashboard.model.requests import Interest
from dyknow_dashboard.model.streams import StreamTable, graph
from dyknow_dashboard.model.verdict_events import EventCounts, VerdictEvent, VerdictWatch
from dyknow_federation.report import FederationReport, peer_texts, shares_text
from dyknow_semantics import Knowledge, Matcher
from dyknow_semantics.hierarchy import HierarchyEntry, hierarchy_entries

MAX_PEERS_SHOWN: Final = 200
"""The number of peers that are shown."""

MAX_KEPT: Final = 100
"""The number of formulas whose signals are kept."""

MAX_KEPT_SIGNALS: Final = 2000
"""The number of signals of all formulas together: 100 MB."""

MAX_CONCEPTS: Final = 1000
"""The number of concepts that are shown."""

MAX_ANNOTATIONS: Final = 500
"""The number of annotations that are shown."""

MAX_OBJECTS: Final = 200
"""The number of objects of a sort that are shown."""

State = tuple[str, int, Mapping[str, Value]]
"""A state: its topic, its valid time in nanoseconds, and its fields."""


class PeerTable:
    """The latest report of the federation node, where there is one."""

    def __init__(self) -> None:
        self.version = 0
        self._report: FederationReport | None = None

    def update(self, report: FederationReport | None) -> None:
        """Take a report; None if the latest one may be old."""
        self._report = report
        self.version += 1

    def document(self) -> dict[str, Any]:
        """Return the peers, with their links and clocks; nothing is shared without a federation."""
        report = self._report
        if report is None:
            return {'shares': '', 'peers': [], 'faults': [], 'hidden': 0}
        shown = report.peers[:MAX_PEERS_SHOWN]
        return {
            'shares': shares_text(report),
            'peers': [peer_texts(each) for each in shown],
            'faults': list(report.faults),
            'hidden': len(report.peers) - len(shown),
        }


class ConceptTable:
    """The latest contents of the ontology manager and the stream semantics manager."""

    def __init__(self) -> None:
        self.version = 0
        self.knowledge: Knowledge | None = None
        self.fault = 'it has not been read yet'
        """Why the ontology is not known; empty if it is."""
        self.domains: dict[str, tuple[str, ...]] = {}
        """The objects of each sort."""
        self.units: dict[str, str] = {}
        """The units of the features that have one."""
        self._document: dict[str, Any] = {'sorts': [], 'features': [], 'annotations': []}

    def update(self, matcher: Matcher, annotations: Mapping[str, str]) -> None:
        """Take new contents.

        Args:
            matcher: the matcher of the ontologies and the valid annotations.
            annotations: all of them, with their faults.
        """
        self.knowledge, self.fault = matcher.knowledge, ''
        entries = hierarchy_entries(matcher)
        shown = entries[:MAX_CONCEPTS]
        knowledge = matcher.knowledge
        domains = {sort: knowledge.instances(sort) for sort in knowledge.sorts}
        if domains != self.domains:
            self.domains = domains
        self.units = {each.name: each.unit for each in knowledge.features if each.unit}
        self._document = {
            'sorts': [_sort(each, knowledge) for each in shown if each.kind == 'sort'],
            'features': [_concept(each) for each in shown if each.kind == 'feature'],
            'annotations': [
                {'text': text, 'fault': fault}
                for text, fault in list(annotations.items())[:MAX_ANNOTATIONS]
            ],
            'hidden': len(entries) - len(shown) + max(len(annotations) - MAX_ANNOTATIONS, 0),
        }
        self.version += 1

    def fail(self, fault: str) -> None:
        """Note why the contents cannot be read now; contents that were read before remain."""
        if fault != self.fault:
            self.fault = fault
            self.version += 1

    def document(self) -> dict[str, Any]:
        """Return all sorts with their objects, features with their streams, and annotations."""
        return {**self._document, 'fault': self.fault}


def _concept(entry: HierarchyEntry) -> dict[str, Any]:
    return {
        'name': entry.name,
        'text': entry.text,
        'parents': list(entry.parents),
        'streams': list(entry.streams),
        'is_provided': entry.is_provided,
    }


def _sort(entry: HierarchyEntry, knowledge: Knowledge) -> dict[str, Any]:
    objects = knowledge.instances(entry.name)
    text = ' = '.join((entry.name, *entry.equivalents))
    shown = list(objects[:MAX_OBJECTS])
    return {**_concept(entry), 'text': text, 'objects': shown, 'count': len(objects)}


@dataclass(slots=True)
class _Shown:
    """The state of an opened formula on a page."""

    version: int = -1
    shape: tuple[Any, ...] | None = None
    latest: int = 0
    signals: LiveSignals | None = None
    image: str = ''


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
        known: the map of the robot.
    """

    def __init__(
        self, clock: Callable[[], int], history: Path | None = None, known: RobotMap = NO_MAP
    ) -> None:
        self.formulas = FormulaTable()
        self.map = LiveMap(known)
        self.streams = StreamTable()
        self.health = HealthTable()
        self.peers = PeerTable()
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
        self.map.follow(self.formulas.by_key(), now)
        if events := self._watch.update(statuses, self.clock()):
            for each in self.sinks:
                each(events)

    def forget(self) -> None:
        """Forget what nodes reported while nobody read it: they may have ended since."""
        self.streams.update((), ())
        self.peers.update(None)

    def state_topics(self, pages: Iterable[PageState]) -> set[str]:
        """Return the topics of the states that signals are kept of, and forget other signals.

        The signals of opened formulas come first, then of failing, running and ended formulas.
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
        """Yield the messages that a page lacks; from then on, the page is assumed to have them."""
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
        elif view == 'nodes':
            yield 'peers', self.peers.version, self.peers.document
        elif view == 'ontology':
            yield 'ontology', self.concepts.version, self.concepts.document

    def _details(self, shown: _Shown, evaluation: MonitoredEvaluation) -> Iterator[dict[str, Any]]:
        key, signals = evaluation.key, self.signals_of(evaluation.key)
        if shown.version != self.formulas.version:
            shown.version = self.formulas.version
            details = self.formulas.details(evaluation)
            yield {'type': 'details', 'id': key, **details}
            if (image := self.map.image(key, evaluation.status)) != shown.image:
                shown.image = image
                yield {'type': 'map', 'id': key, 'image': image}
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
