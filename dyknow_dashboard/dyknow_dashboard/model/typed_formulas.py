"""A formula while it is typed: its faults, and what may be written at the cursor."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from typing import Any, Final, get_args

from dyknow_common import (
    FORMULA_WORDS,
    FUNCTIONS,
    LanguageError,
    Symbol,
    SymbolKind,
    position_at,
)
from dyknow_dashboard.errors import DashboardError
from dyknow_reasoning import (
    Always,
    Eventually,
    PastFormula,
    Until,
    check_types,
    notes_on,
    parse_formula,
    symbols_of,
)
from dyknow_semantics import FeatureSignature, Knowledge, SemanticsError

MAX_FORMULA: Final = 10_000
"""The number of characters of a formula that a page may send."""

MAX_PROPOSALS: Final = 12

_NAME: Final = re.compile(r'[A-Za-z_]\w*$', re.ASCII)

_OPERATORS: Final = {
    **{each.symbol: each.usage for each in (Always, Eventually, Until, *get_args(PastFormula))},
    'forall': 'forall u in UAV: F, for each object',
    'exists': 'exists u in UAV: F, for some object',
    'let': 'let limit = 150 W in F: a named constant',
}


def check_length(text: str) -> None:
    """Check that a formula is not too long to be checked at each key.

    Raises:
        DashboardError: if it is.
    """
    if len(text) > MAX_FORMULA:
        raise DashboardError(
            f'the formula has {len(text)} characters, and the page takes at most {MAX_FORMULA}; '
            'use FormulaClient or dyknow evaluate'
        )


def check(text: str, knowledge: Knowledge | None) -> dict[str, Any]:
    """Return whether a text is a formula: its canonical text with notes, or the fault.

    Args:
        text: the formula.
        knowledge: the ontology; None if it is not known.

    Raises:
        DashboardError: if the text is too long.
    """
    check_length(text)
    if not text.strip():
        return {'canonical': '', 'notes': []}
    try:
        formula = parse_formula(text)
        check_types(formula, text)
    except LanguageError as error:
        position = error.position
        return {'fault': error.message, 'line': position.line, 'column': position.column}
    unknown = [] if knowledge is None else list(_unknown(text, symbols_of(formula), knowledge))
    return {'canonical': str(formula), 'notes': [*map(str, notes_on(text)), *unknown]}


def proposals(text: str, cursor: int, knowledge: Knowledge | None) -> list[dict[str, Any]]:
    """Return what may complete the name that ends at the cursor.

    Each has the text to insert, its kind, a note, and where the text that it replaces begins.
    """
    found = _NAME.search(text[:cursor])
    if found is None:
        return []
    typed = found[0].lower()
    matching = [each for each in _candidates(knowledge) if each[0].lower().startswith(typed)]
    return [
        {'text': name, 'kind': kind, 'note': note, 'from': found.start()}
        for name, kind, note in matching[:MAX_PROPOSALS]
        if name != found[0]
    ]


def _candidates(knowledge: Knowledge | None) -> Iterator[tuple[str, str, str]]:
    """Yield names with their kinds and notes, the names of the ontology first."""
    if knowledge is not None:
        for feature in knowledge.features:
            yield feature.name, 'feature', _signature(feature)
        for sort in knowledge.sorts:
            yield sort, 'sort', f'{len(knowledge.instances(sort))} objects'
        for name in dict.fromkeys(
            each for sort in knowledge.sorts for each in knowledge.instances(sort)
        ):
            yield name, 'object', ''
    for word in sorted(FORMULA_WORDS):
        yield word, 'operator', _OPERATORS.get(word, '')
    for function in sorted(FUNCTIONS):
        yield function, 'function', ''


def _signature(feature: FeatureSignature) -> str:
    arguments = f'[{", ".join(feature.argument_sorts)}]' if feature.argument_sorts else ''
    unit = f' in {feature.unit}' if feature.unit else ''
    return f'{arguments}: {feature.value_type}{unit}'


def _unknown(text: str, symbols: Iterable[Symbol], knowledge: Knowledge) -> Iterator[str]:
    """Yield notes on features with arguments that the ontology does not have."""
    for symbol in symbols:
        if symbol.kind is SymbolKind.FEATURE and symbol.arguments:
            try:
                knowledge.feature(symbol.name)
            except SemanticsError as error:
                used = re.search(rf'\b{re.escape(symbol.name)}\b', text)
                place = position_at(text, used.start() if used else 0)
                yield LanguageError(error.message, 'formula', text, place).message
