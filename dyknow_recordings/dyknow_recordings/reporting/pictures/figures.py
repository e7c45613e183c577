"""The figures of a page, as the data that its script draws."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any, Final

from dyknow_recordings.evaluation.observation import Signal
from dyknow_recordings.reporting.pictures.panels import Marks, Panel, last_shown
from dyknow_recordings.reporting.pictures.timeline import Span

_MARGIN: Final = 0.01
"""The share of the time that is left free at both sides."""


class PageFigures:
    """Collects the panels of all formulas; signals of several formulas are stored once."""

    def __init__(self) -> None:
        self._signals: list[dict[str, Any]] = []
        # The signals are kept, so that their ids stay theirs.
        self._indices: dict[int, tuple[int, Signal]] = {}
        self._formulas: list[dict[str, Any]] = []
        self._units: list[str] = []
        self._whole = Span(0, 1)
        self._is_any_open = False

    def open_once(self) -> str:
        """Return the attribute that opens the details of a formula, for the first call alone."""
        is_first, self._is_any_open = not self._is_any_open, True
        return ' open' if is_first else ''

    def begin_recording(self, whole: Span) -> None:
        """Begin the formulas of another recording."""
        self._whole = whole
        self._units.append(whole.unit)

    def add(self, panels: list[Panel], marks: Marks) -> None:
        """Add a formula."""
        end = self._time(last_shown(self._whole, marks))
        self._formulas.append(
            {
                'recording': len(self._units) - 1,
                'range': [-_MARGIN * end, (1 + _MARGIN) * end],
                'panels': [self._panel(each) for each in panels],
                'marks': self._marks(marks),
            }
        )

    def document(self) -> dict[str, Any]:
        """Return all data."""
        return {'signals': self._signals, 'formulas': self._formulas, 'unit': self._units}

    def _panel(self, panel: Panel) -> dict[str, Any]:
        return {
            'is_decisive': panel.is_decisive,
            'unit': escape(panel.unit),
            'signals': [self._signal(each) for each in panel.signals],
            'relations': [escape(each) for each in panel.relations],
            'thresholds': [
                {'value': each.value, 'text': escape(each.text)} for each in panel.thresholds
            ],
        }

    def _marks(self, marks: Marks) -> dict[str, Any]:
        return {
            'deciding': [
                {
                    'time': self._time(each.time),
                    'verdict': each.verdict,
                    'values': {escape(name): _number(value) for name, value in each.values.items()},
                }
                for each in marks.deciding
            ],
            'windows': [self._span(each) for each in marks.windows],
            'pending': [self._span(each) for each in marks.pending],
            'gaps': [self._span(each) for each in marks.gaps],
            'unknown': self._named(marks.unknown),
            'held': self._named(marks.held),
            'violations': [self._time(each) for each in marks.violations],
        }

    def _signal(self, signal: Signal) -> int:
        if id(signal) not in self._indices:
            self._indices[id(signal)] = len(self._signals), signal
            self._signals.append(
                {
                    'name': escape(signal.name),
                    't': [self._time(int(each)) for each in signal.times],
                    **lines(signal),
                    'words': [escape(each) for each in signal.words],
                }
            )
        return self._indices[id(signal)][0]

    def _named(self, spans: Mapping[str, Sequence[Span]]) -> dict[str, list[list[float]]]:
        return {escape(name): [*map(self._span, found)] for name, found in spans.items() if found}

    def _span(self, span: Span) -> list[float]:
        return [self._time(span.start), self._time(span.end)]

    def _time(self, time: int) -> float:
        return round(self._whole.since_start(time), 6)


def lines(signal: Signal, first: int = 0) -> dict[str, list[float | None]]:
    """Return the values of a signal and the ends of its band from a point on, for scripts."""
    low, high = signal.band or ((), ())
    named = {'v': signal.values, 'low': low, 'high': high}
    return {name: [_number(float(each)) for each in line[first:]] for name, line in named.items()}


def _number(value: float) -> float | None:
    """Return a number with the digits that can be seen; None for a missing one."""
    return float(f'{value:.7g}') if math.isfinite(value) else None
