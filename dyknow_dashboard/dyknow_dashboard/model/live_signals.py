"""The signals of a formula over its last states, as the drawing of its panels."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np

from dyknow_common import SECOND_NS, DyKnowError, SymbolKind, Value, earliest
from dyknow_coordinator import EvaluationPhase, EvaluationStatus
from dyknow_dashboard.model.live_reports import WINDOW_NS, live_report
from dyknow_reasoning import parse_formula, symbols_of
from dyknow_recordings import FormulaReport
from dyknow_recordings.evaluation.observation import (
    Signal,
    SignalRecorder,
    StateSignals,
    terms_of,
)
from dyknow_recordings.reporting.pictures.page import PageFigures, lines
from dyknow_recordings.reporting.pictures.panels import Panel, last_shown, marks, panels
from dyknow_recordings.reporting.pictures.timeline import Span

_BLOCK: Final = 256
"""The number of states that are collected before they are added to the signals.

With MAX_POINTS, a signal without a band takes at most 50 KB.
"""

_MARGIN: Final = 0.01
"""The share of the time that is left free at both sides."""

Domains = Mapping[str, tuple[str, ...]]


def domains_of(status: EvaluationStatus, known: Domains) -> dict[str, tuple[str, ...]]:
    """Return the objects of each sort of a formula: the objects that its streams are about.

    They were fixed when it was asked; the ontology may have other objects now, or is not read yet.

    Args:
        status: the status of its evaluation.
        known: the objects of each sort in the ontology, as far as they are known.
    """
    try:
        symbols = symbols_of(parse_formula(status.formula))
    except DyKnowError:
        return {}
    found = dict.fromkeys(
        name
        for each in status.groundings
        for name in each.symbol.partition('[')[2].removesuffix(']').split(', ')
        if name
    )
    return {
        each.name: tuple(name for name in found if name in known.get(each.name, found))
        for each in symbols
        if each.kind is SymbolKind.SORT
    }


class LiveSignals:
    """The signals of one formula over the last states, and what is drawn of them.

    They end with the formula, though other formulas may be asked over the same states. Times in
    drawings are seconds since the evaluation was started.

    Args:
        status: the status of the evaluation.
        known: the objects of each sort in the ontology, as far as they are known.
    """

    def __init__(self, status: EvaluationStatus, known: Domains) -> None:
        self.units: Mapping[str, str] = {}
        """The units of features, by their names, as far as they are known."""
        self.domains: Domains = {}
        """The objects of each sort."""
        self.topic = ''
        """The topic of the states; it remains when the evaluation has ended."""
        self.latest = status.started
        """The valid time of the latest state."""
        self.shape: tuple[Any, ...] = ()
        """It is the same as long as `points` can continue a drawing."""
        self._origin = status.started
        self._end: int | None = None
        self._panels: list[Panel] = []
        self._omitted = 0
        self._basis: tuple[Any, ...] = ()
        self._terms: frozenset[str] = frozenset()
        self._recorder = SignalRecorder((), {})
        self.follow(status, known)

    @property
    def count(self) -> int:
        """The number of signals; one with a band counts as the six that need its memory."""
        return self._recorder.size

    @property
    def is_complete(self) -> bool:
        """True if the formula has ended, and no earlier state is to come."""
        return self._end is not None and self.latest >= self._end

    def follow(self, status: EvaluationStatus, known: Domains) -> None:
        """Use a later status of the evaluation for the states to come."""
        self._status = status
        self.topic = status.state_stream or self.topic
        self._end = None
        if status.phase is EvaluationPhase.ENDED:
            ends = status.decided_at, status.latest_valid_time, status.started
            self._end = next(each for each in ends if each is not None)
            self.latest = min(self.latest, self._end)
        basis = status.formula, status.groundings, known
        if basis != self._basis:
            self._basis = basis
            self._use(status.formula, domains_of(status, known))

    def add(self, valid_time: int, fields: Mapping[str, Value]) -> None:
        """Add a state; a state that is not later than earlier ones is not drawn."""
        if self._end is None or valid_time <= self._end:
            columns = {name: (each,) for name, each in earliest(fields).items()}
            self._recorder.states((valid_time,), columns)
            self.latest = max(self.latest, valid_time)

    def update(self) -> None:
        """Find the panels of the signals so far."""
        try:
            self._panels, self._omitted = panels(self._report())
        except DyKnowError:  # The objects of a sort are not known yet.
            self._panels, self._omitted = [], 0
        shapes = (
            (
                (each.objects, each.is_decisive, each.unit, each.relations),
                [(signal.name, signal.words) for signal in each.signals],
            )
            for each in self._panels
        )
        self.shape = self._end, *shapes

    def drawing(self) -> dict[str, Any]:
        """Return the whole drawing, in the form of the pages of a check."""
        self.update()
        captions = [
            {
                'objects': each.objects,
                'is_decisive': each.is_decisive and bool(each.objects),
                'title': ', '.join(each.atoms),
                'names': [one.name for one in each.signals],
            }
            for each in self._panels
        ]
        return {**self._document(self._panels), 'captions': captions, 'omitted': self._omitted}

    def points(self, since: int) -> dict[str, Any]:
        """Return the part of the drawing that is later than a valid time, with all marks.

        Its signals are in the order of the drawing.
        """
        signals = self._signals().signals
        names = dict.fromkeys(one.name for each in self._panels for one in each.signals)
        return {
            **self._document([]),
            'signals': [self._points(signals[name], since) for name in names],
        }

    def _document(self, found: Sequence[Panel]) -> dict[str, Any]:
        report = self._report()
        signals = () if report.signals is None else report.signals.signals.values()
        first = min((int(each.times[0]) for each in signals if len(each.times)), default=0)
        begin = max(self._origin, first, self.latest - WINDOW_NS)
        whole = Span(begin, max(self.latest, begin + SECOND_NS))
        shown = marks(report, whole)
        figures = PageFigures()
        figures.begin_recording(Span(self._origin, self._origin + 1))
        figures.add(list(found), shown)
        document = figures.document()
        (formula,) = document['formulas']
        # The deciding state itself may be missing: its stream ends with the evaluation.
        end = max([last_shown(whole, shown), *(each.time for each in shown.deciding)])
        margin = round((end - begin) * _MARGIN)
        formula['range'] = [self._seconds(begin - margin), self._seconds(end + margin)]
        return document

    def _use(self, formula: str, domains: Domains) -> None:
        """Record the terms of some objects; keep the signals so far if they include these."""
        self.domains = domains
        try:
            terms = terms_of([formula], domains)
        except DyKnowError:  # The objects of a sort are not known yet.
            terms = []
        names = frozenset(map(str, terms))
        if not names <= self._terms:
            self._terms = names
            # The first states may have come before this page was open.
            self._recorder = SignalRecorder(terms, domains, WINDOW_NS, _BLOCK, is_asked_once=False)

    def _report(self) -> FormulaReport:
        """Return the report; its latest episode comes first, as the decisive one."""
        report = live_report(self._status, self._signals())
        return replace(report, episodes=report.episodes[::-1], units=self.units)

    def _signals(self) -> StateSignals:
        """Return the signals, with their values at the deciding states."""
        found = self._recorder.result()
        signals = {name: self._ended(each) for name, each in found.signals.items()}
        episodes = self._status.episodes
        times = [each.decided_at for each in episodes.latest_episodes] if episodes else []
        deciding = {
            time: {each.name: _value_at(each, time) for each in signals.values()}
            for time in (*times, self._status.decided_at)
            if time is not None
        }
        return StateSignals(signals, self.domains, deciding, found.omitted)

    def _ended(self, signal: Signal) -> Signal:
        """Return a signal without the states that came after the end of the formula."""
        if self._end is None:
            return signal
        count = int(np.searchsorted(signal.times, self._end, side='right'))
        times, values = signal.times[:count], signal.values[:count]
        band = signal.band and (signal.band[0][:count], signal.band[1][:count])
        return replace(signal, times=times, values=values, band=band)

    def _seconds(self, time: int) -> float:
        return round((time - self._origin) / SECOND_NS, 6)

    def _points(self, signal: Signal, since: int) -> dict[str, Any]:
        first = int(np.searchsorted(signal.times, since, side='right'))
        return {
            't': [self._seconds(int(each)) for each in signal.times[first:]],
            **lines(signal, first),
        }


def _value_at(signal: Signal, time: int) -> float:
    index = int(np.searchsorted(signal.times, time))
    is_known = index < len(signal.times) and signal.times[index] == time
    return float(signal.values[index]) if is_known else math.nan
