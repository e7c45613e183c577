"""The signals of a formula as panels: for each choice of objects, what its atoms compare.

Relations of objects in space, `inside` and `in_sight`, and what holds along links, are bars.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from itertools import chain
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dyknow_common import COMPARISONS, MIRRORED_COMPARISONS, DyKnowError
from dyknow_configuration import POSITION_FEATURES
from dyknow_reasoning import (
    SPATIAL,
    Comparison,
    Feature,
    FieldReference,
    Number,
    Over,
    StateAtom,
    Term,
    as_written,
    best_estimate,
    ground_atoms,
    objects_text,
    parse_formula,
    walk,
)
from dyknow_recordings.evaluation.bands import forecast_bands
from dyknow_recordings.evaluation.observation import (
    MAX_POINTS,
    MAX_SIGNALS,
    MAX_SPANS,
    Signal,
    StateSignals,
    extremes,
    features_of,
    sides_of,
    signal_name,
    with_inner_atoms,
)
from dyknow_recordings.evaluation.results import FormulaReport
from dyknow_recordings.reporting.pictures.timeline import (
    MAX_MARKS,
    Span,
    episode_runs,
    gaps,
    last_state,
    pending_windows,
    spans_where,
)

MAX_PANELS: Final = 24
"""The number of panels that are shown of one formula."""

_FEATURE: Final = re.compile(r'(?:abs\()?(\w+)(\[[^\]]*\])?\)?')
"""The text of a feature, such as `Power[uav1]`, or of its absolute value."""


_FEW_MARGINS: Final = 2
"""The number of margins that are drawn; the table has a single one."""

MAX_RELATIONS: Final = 40
"""The relations of a formula that are shown: the first that held."""

_NAMES: Final = {text: name for name, text in SPATIAL.items()}


@dataclass(frozen=True, slots=True)
class Threshold:
    """A constant that a signal is compared with.

    Args:
        value: the constant.
        text: the comparisons, `> 10`.
    """

    value: float
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """The signals that some atoms of a formula compare.

    Args:
        objects: the choice of objects, `u = uav1`; empty without one.
        atoms: their texts.
        signals: signals that are drawn together, because an atom compares them.
        thresholds: the thresholds of these signals.
        is_decisive: True if these objects decided the formula.
        unit: the signals' unit in the formula, or else of their features; empty if unknown.
        relations: replace signals: a row for each relation, with a bar while it held.
    """

    objects: str
    atoms: tuple[str, ...]
    signals: tuple[Signal, ...]
    thresholds: tuple[Threshold, ...]
    is_decisive: bool
    unit: str = ''
    relations: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class DecidingState:
    """A state that decided an episode: its time, the verdict, and the values of the signals."""

    time: int
    verdict: str
    values: Mapping[str, float]


@dataclass(frozen=True, slots=True)
class Marks:
    """Marks in all panels of a formula.

    Args:
        deciding: the states that decided the first episode of each run with the worst outcome.
        windows: the intervals of time that the explanation names.
        pending: the intervals in which the formula still awaits something.
        gaps: times in which states may be missing.
        unknown: times in which a signal has no value, by the name of the signal.
        violations: the times at which streams broke their constraints.
        held: times in which relations held, by their texts.
    """

    deciding: tuple[DecidingState, ...] = ()
    windows: tuple[Span, ...] = ()
    pending: tuple[Span, ...] = ()
    gaps: tuple[Span, ...] = ()
    unknown: Mapping[str, tuple[Span, ...]] = field(default_factory=dict)
    violations: tuple[int, ...] = ()
    held: Mapping[str, tuple[Span, ...]] = field(default_factory=dict)


def formula_text(formula: str) -> str:
    """Return a canonical text with its numbers as they were written, for people."""
    try:
        return str(as_written(parse_formula(formula)))
    except DyKnowError:  # What was asked is no formula.
        return formula


def panels(formula: FormulaReport) -> tuple[list[Panel], int]:
    """Return the panels of a formula, and the number of omitted ones.

    The panels of the stream that has ended the formula come first, then the decisive ones.
    """
    if formula.signals is None:
        return [], 0
    decisive = formula.decisive
    deciding_objects = '' if decisive is None else decisive.objects
    found: list[Panel] = []
    for binding, atoms in ground_atoms(parse_formula(formula.formula), formula.signals.domains):
        objects = objects_text(binding)
        is_decisive = objects == deciding_objects
        found += _panels_of(objects, atoms, formula.signals, is_decisive=is_decisive)
    found = [_with_unit(each, formula.units) for each in found]
    found += _probability_panel(formula.asked_probability, formula.signals)
    found += _margin_panel(formula)
    at_fault = _symbols_at_fault(formula)
    found.sort(
        key=lambda each: (at_fault.isdisjoint(it.name for it in each.signals), not each.is_decisive)
    )
    if held := tuple(held_spans(formula.formula, formula.signals)):
        # Of all objects at once: it is seen also where decisive panels are many.
        relations = Panel('', ('relations that held',), (), (), is_decisive=False, relations=held)
        found.insert(1, relations)
    return found[:MAX_PANELS], max(len(found) - MAX_PANELS, 0)


def _symbols_at_fault(formula: FormulaReport) -> set[str]:
    """Return the symbols whose stream has ended a formula by its last violation."""
    if formula.error is None or not formula.violations:
        return set()
    name = re.compile(rf'(?<![\w/]){re.escape(formula.violations[-1].stream_name)}(?![\w/])')
    return {each.symbol for each in formula.groundings if name.search(each.stream)}


def marks(formula: FormulaReport, whole: Span) -> Marks:
    """Return what is marked in the panels of a formula."""
    decisive = formula.decisive
    values = {} if formula.signals is None else formula.signals.deciding
    worst = [run[0] for run in episode_runs(formula) if run[0].outcome is formula.outcome]
    deciding = {
        each.decided_at: DecidingState(
            each.decided_at, each.outcome, values.get(each.decided_at, {})
        )
        for each in worst[:MAX_MARKS]
        if each.decided_at is not None
    }
    now, missing = last_state(formula, whole), gaps(formula, whole)
    signals = {} if formula.signals is None else formula.signals.signals
    return Marks(
        deciding=tuple(deciding.values()),
        windows=() if decisive is None else tuple(Span(*each) for each in decisive.windows),
        pending=() if decisive is None else tuple(pending_windows(decisive, now)[:MAX_MARKS]),
        gaps=missing,
        unknown={name: unknown_spans(each, missing) for name, each in signals.items()},
        violations=tuple(each.valid_time for each in formula.violations[:MAX_MARKS]),
        held=held_spans(formula.formula, formula.signals) if formula.signals else {},
    )


def unknown_spans(signal: Signal, gaps: Iterable[Span]) -> tuple[Span, ...]:
    """Return the times in which a signal has no value, but for gaps in the states."""
    # A gap interrupts signals right after the last state before it.
    interruptions = [each.start + 1 for each in gaps]
    is_missing = np.isnan(signal.values) & ~np.isin(signal.times, interruptions)
    return spans_where(signal.times, is_missing)[:MAX_MARKS]


def last_shown(whole: Span, found: Marks) -> int:
    """Return the time up to which panels show pending windows: a third of the whole at most."""
    latest = whole.end + (whole.end - whole.start) // 3
    return max([whole.end, *(min(each.end, latest) for each in found.pending)])


def _panels_of(
    objects: str,
    atoms: Iterable[Comparison | Feature | FieldReference],
    known: StateSignals,
    *,
    is_decisive: bool,
) -> list[Panel]:
    """Return a panel for each set of signals that atoms compare."""
    texts: dict[tuple[str, ...], list[str]] = {}
    thresholds: dict[tuple[str, ...], dict[float, dict[str, None]]] = {}
    units: dict[tuple[str, ...], str] = {}
    shown = list(with_inner_atoms(atoms))
    bands = forecast_bands(side for atom in shown for side in sides_of(atom))
    for atom in shown:
        sides = sides_of(atom)
        named = dict.fromkeys(signal_name(bands.get(str(each), each)) for each in sides)
        # A feature that the formula does not depend on after its simplification has no values.
        names = tuple(name for name in named if _has_values(known.signals.get(name)))
        if names:
            texts.setdefault(names, []).append(str(as_written(best_estimate(atom))))
            found = thresholds.setdefault(names, {})
            for each in sides:
                if isinstance(each, Number) and each.unit:
                    units[names] = each.unit
            if isinstance(atom, Comparison) and (threshold := _threshold(atom, sides)):
                found.setdefault(threshold.value, {})[threshold.text] = None
    return [
        Panel(
            objects,
            tuple(found),
            tuple(known.signals[name] for name in names),
            tuple(Threshold(value, ', '.join(each)) for value, each in thresholds[names].items()),
            is_decisive,
            units.get(names, ''),
        )
        for names, found in texts.items()
    ]


def _with_unit(panel: Panel, units: Mapping[str, str]) -> Panel:
    """Return a panel in the unit of its features, unless its formula has units itself."""
    features = [_FEATURE.fullmatch(each.name) for each in panel.signals]
    found = {units.get(each[1], '') if each else '' for each in features}
    if panel.unit or found == {''} or len(found) > 1:
        return panel
    (unit,) = found
    limits = tuple(replace(each, text=f'{each.text} {unit}') for each in panel.thresholds)
    return replace(panel, unit=unit, thresholds=limits)


def _probability_panel(asked: str, known: StateSignals) -> Iterator[Panel]:
    """Yield the panel of the probability of a whole formula, if it was asked for."""
    for _, atoms in ground_atoms(parse_formula(asked), known.domains) if asked else ():
        for name in map(signal_name, sides_of(atoms[0])):
            signal = known.signals.get(name)
            if signal is not None and _has_values(signal):
                signals = (replace(signal, name='probability'),)
                yield Panel('', ('probability',), signals, (), is_decisive=False)


def _margin_panel(formula: FormulaReport) -> list[Panel]:
    """Return the panel of the margins from each state on, if they are known of several."""
    runs = [each.report.episodes for each in formula.attempts] or [formula.episodes]
    parts = [
        [(it.begin, it.margin) for it in run if it.begin is not None and it.margin is not None]
        for run in runs
    ]
    known = list(chain.from_iterable(parts))
    times = np.array([begin for begin, _ in known], np.int64)
    ends = np.array([(margin.lower, margin.upper) for _, margin in known]).reshape(-1, 2)
    ends[~np.isfinite(ends)] = np.nan
    if max(map(len, parts)) < _FEW_MARGINS or np.isnan(ends).all():
        return []
    # No line joins two evaluations.
    breaks = np.cumsum([len(each) for each in parts if each])[:-1]
    times, ends = np.insert(times, breaks, times[breaks]), np.insert(ends, breaks, np.nan, axis=0)
    kept = np.arange(len(times))
    if len(times) > MAX_POINTS:
        spans = kept * MAX_SPANS // len(times)
        kept = np.unique(np.concatenate([extremes(spans, each) for each in ends.T]))
    low, high = ends[kept].T
    least = Signal('margin: at least', times[kept], low, band=(low, high))
    signals = least, Signal('margin: at most', times[kept], high)
    unit = known[0][1].unit
    return [Panel('', ('margin',), signals, (Threshold(0.0, '0'),), is_decisive=False, unit=unit)]


def _has_values(signal: Signal | None) -> bool:
    return signal is not None and not np.isnan(signal.values).all()


def _threshold(atom: Comparison, sides: Sequence[Term]) -> Threshold | None:
    if atom.left not in sides:  # A value of the past, which has no line.
        return None
    if isinstance(atom.right, Number):
        return Threshold(float(atom.right.value), f'{atom.operator} {as_written(atom.right)}')
    if isinstance(atom.left, Number):
        operator = MIRRORED_COMPARISONS.get(atom.operator, atom.operator)
        return Threshold(float(atom.left.value), f'{operator} {as_written(atom.left)}')
    return None


def held_spans(formula: str, known: StateSignals) -> dict[str, tuple[Span, ...]]:
    """Return when the relations of a formula held, by their texts; omit relations that never held.

    Args:
        formula: its canonical text.
        known: the signals of its states.
    """
    domains = tuple((sort, tuple(objects)) for sort, objects in known.domains.items())
    found: dict[str, tuple[Span, ...]] = {}
    for text, relation in _relations(formula, domains).items():
        if len(found) < MAX_RELATIONS and (spans := _spans(relation, known)):
            found[text] = spans
    return found


class _Relation(NamedTuple):
    """A comparison of two signals by name, or of one with a number; true is 1."""

    left: str | float
    operator: str
    right: str | float


@lru_cache(maxsize=64)
def _relations(
    formula: str, domains: tuple[tuple[str, tuple[str, ...]], ...]
) -> Mapping[str, _Relation]:
    """Return the relations of positions, and what holds at the objects that links join."""
    parsed = parse_formula(formula)
    has_links = any(isinstance(each, Over) for each in walk(parsed))
    found: dict[str, _Relation] = {}
    for atom in (atom for _, atoms in ground_atoms(parsed, dict(domains)) for atom in atoms):
        names = {each.name for each in features_of(atom) if isinstance(each, Feature)}
        if (names and names <= POSITION_FEATURES) or (has_links and isinstance(atom, Feature)):
            found[_text(atom)] = _relation(atom)
        if len(found) == MAX_SIGNALS:
            break  # Further relations have no signals.
    return found


def _relation(atom: StateAtom) -> _Relation:
    if isinstance(atom, Comparison):
        return _Relation(_side(atom.left), atom.operator, _side(atom.right))
    return _Relation(_side(atom), '=', 1.0)


def _side(term: Term) -> str | float:
    return float(term.value) if isinstance(term, Number) else signal_name(term)


def _text(atom: StateAtom) -> str:
    """Return a relation as formulas have it, `inside(r1, dock)`."""
    written = str(as_written(best_estimate(atom)))
    before, _, rest = written.partition('[')
    arguments, _, after = rest.partition(']')
    name = _NAMES.get(f'{before}[r, s]{after}')
    return f'{name}({arguments})' if name else written


def _spans(relation: _Relation, known: StateSignals) -> tuple[Span, ...]:
    """Return the spans in which a relation holds, each to the first state where it does not."""
    sides = relation.left, relation.right
    lines = [known.signals.get(each) if isinstance(each, str) else each for each in sides]
    signals = [each for each in lines if isinstance(each, Signal)]
    if None in lines or not signals:
        return ()
    times = np.unique(np.concatenate([each.times for each in signals]))
    left, right = (_values_at(each, times) for each in lines)
    holds = np.asarray(COMPARISONS[relation.operator](left, right), np.bool_)
    return spans_where(times, holds & ~(np.isnan(left) | np.isnan(right)))


def _values_at(line: Signal | float | None, times: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the latest values of a signal at times; NaN before its first."""
    if not isinstance(line, Signal):
        return np.full(len(times), line, np.float64)
    indices = np.searchsorted(line.times, times, 'right') - 1
    found: NDArray[np.float64] = np.where(indices < 0, np.nan, line.values[indices])
    return found
