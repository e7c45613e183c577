"""Relations of objects in space over time: `inside`, `in_sight`, what holds along links."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from dyknow_common import COMPARISONS
from dyknow_configuration import POSITION_FEATURES
from dyknow_reasoning import (
    SPATIAL,
    Comparison,
    Feature,
    Number,
    Over,
    StateAtom,
    Term,
    as_written,
    best_estimate,
    ground_atoms,
    parse_formula,
    walk,
)
from dyknow_recordings.evaluation.observation import (
    MAX_SIGNALS,
    Signal,
    StateSignals,
    features_of,
    signal_name,
)
from dyknow_recordings.reporting.pictures.timeline import Span, spans_where

MAX_RELATIONS: Final = 40
"""The relations of a formula that are shown: the first that held."""

_NAMES: Final = {text: name for name, text in SPATIAL.items()}


def held_spans(formula: str, known: StateSignals) -> dict[str, tuple[Span, ...]]:
    """Return when the relations of a formula held, by their texts; without those that never did.

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
            break  # Of others, there are no signals.
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
