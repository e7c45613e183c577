"""Relations of objects in space over time: `inside`, `in_sight`, what holds along links."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import Final

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
    as_written,
    best_estimate,
    ground_atoms,
    parse_formula,
    walk,
)
from dyknow_recordings.evaluation.observation import (
    Signal,
    StateSignals,
    features_of,
    signal_name,
)
from dyknow_recordings.reporting.pictures.timeline import Span, spans_where

MAX_RELATIONS: Final = 40
"""The relations of a formula that are shown: the first that held."""

_NAMES: Final = {text: name for name, text in SPATIAL.items()}
_BOOLEAN: Final = ('false', 'true')


def held_spans(formula: str, known: StateSignals) -> dict[str, tuple[Span, ...]]:
    """Return when the relations of a formula held, by their texts; without those that never did.

    Args:
        formula: its canonical text.
        known: the signals of its states.
    """
    domains = tuple((sort, tuple(objects)) for sort, objects in known.domains.items())
    found: dict[str, tuple[Span, ...]] = {}
    for text, atom in _relations(formula, domains).items():
        if len(found) < MAX_RELATIONS and (spans := _spans(atom, known)):
            found[text] = spans
    return found


@lru_cache(maxsize=64)
def _relations(
    formula: str, domains: tuple[tuple[str, tuple[str, ...]], ...]
) -> Mapping[str, StateAtom]:
    """Return the atoms about positions, and what holds at the objects that links join."""
    parsed = parse_formula(formula)
    has_links = any(isinstance(each, Over) for each in walk(parsed))
    found: dict[str, StateAtom] = {}
    for _, atoms in ground_atoms(parsed, dict(domains)):
        for atom in atoms:
            names = {each.name for each in features_of(atom) if isinstance(each, Feature)}
            if (names and names <= POSITION_FEATURES) or (has_links and isinstance(atom, Feature)):
                found[_text(atom)] = atom
    return found


def _text(atom: StateAtom) -> str:
    """Return a relation as formulas have it, `inside(r1, dock)`."""
    written = str(as_written(best_estimate(atom)))
    before, _, rest = written.partition('[')
    arguments, _, after = rest.partition(']')
    name = _NAMES.get(f'{before}[r, s]{after}')
    return f'{name}({arguments})' if name else written


def _spans(atom: StateAtom, known: StateSignals) -> tuple[Span, ...]:
    """Return the spans in which an atom holds, each from a state to the first where it does not."""
    sides = (atom.left, atom.right) if isinstance(atom, Comparison) else (atom,)
    names = [signal_name(each) for each in sides if not isinstance(each, Number)]
    signals = [known.signals[name] for name in names if name in known.signals]
    if len(signals) < len(names) or (len(sides) == 1 and signals[0].words != _BOOLEAN):
        return ()
    times = np.unique(np.concatenate([each.times for each in signals]))
    rest = iter(signals)
    values = np.array(
        [
            np.full(len(times), float(each.value))
            if isinstance(each, Number)
            else _values_at(next(rest), times)
            for each in sides
        ]
    )
    if isinstance(atom, Comparison):
        compared = np.asarray(COMPARISONS[atom.operator](*values), np.bool_)
        return spans_where(times, compared & ~np.isnan(values).any(axis=0))
    return spans_where(times, values[0] == 1)


def _values_at(signal: Signal, times: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the values that a signal has at times; NaN before its first."""
    indices = np.searchsorted(signal.times, times, 'right') - 1
    found: NDArray[np.float64] = np.where(indices < 0, np.nan, signal.values[indices])
    return found
