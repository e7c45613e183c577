"""Requests of pages: JSON whose every part is checked, as any program may send it."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, TypeVar

from dyknow_common import shortened
from dyknow_dashboard.errors import DashboardError
from dyknow_dashboard.model.history import LAST, HistoryQuery
from dyknow_dashboard.model.typed_formulas import check_length

MAX_NAME: Final = 10_000
"""The number of characters of a name that a page may send: a formula may be its own name."""

MAX_KEY: Final = 100
"""The number of characters of the key of an evaluation."""

MAX_IDS: Final = 1000
"""The number of failures that a request may acknowledge, clear or ask for."""

MAX_OPERATOR: Final = 100
"""The number of characters of the text that says who has acknowledged a failure."""

MAX_TIMEOUT_S: Final = 7 * 86_400.0

VIEWS: Final = ('formulas', 'history', 'streams', 'graph', 'nodes', 'ontology')

MAX_OPEN: Final = 8
"""The number of formulas that one page may have open."""

Kind = TypeVar('Kind')


@dataclass(frozen=True, slots=True)
class TypedText:
    """A formula that is being typed, to be checked and completed at a cursor."""

    text: str
    cursor: int


@dataclass(frozen=True, slots=True)
class AskedFormula:
    """A formula to be monitored.

    Args:
        formula: its text.
        name: shown to operators; empty: the formula.
        every_state: True to ask it at every state.
        margin: True to compute its margin.
        timeout_s: the time after which its evaluation ends.
    """

    formula: str
    name: str
    every_state: bool
    margin: bool
    timeout_s: float


@dataclass(frozen=True, slots=True)
class Interest:
    """The part of the system that a page shows.

    Args:
        view: one of VIEWS.
        opened: the keys of the evaluations whose details it shows.
    """

    view: str = 'formulas'
    opened: tuple[str, ...] = ()


def read_document(content: bytes | str) -> Mapping[str, Any]:
    """Return the JSON object in a request.

    Raises:
        DashboardError: if there is none.
    """
    try:
        document = json.loads(content, parse_constant=_refuse_constant)
    except (ValueError, RecursionError) as error:
        raise DashboardError(f'the request is not JSON: {shortened(error)}') from None
    if not isinstance(document, dict):
        raise DashboardError('the request is not a JSON object')
    return document


def typed_text(document: Mapping[str, Any]) -> TypedText:
    """Return a request to check a formula.

    Raises:
        DashboardError: naming the part that is missing or wrong.
    """
    _check_names(document, {'text', 'cursor'})
    text, cursor = _part(document, 'text', str), _part(document, 'cursor', int)
    check_length(text)
    if not 0 <= cursor <= len(text):
        raise DashboardError(f"'cursor' is {cursor}, outside the text")
    return TypedText(text, cursor)


def asked_formula(document: Mapping[str, Any]) -> AskedFormula:
    """Return a request to monitor a formula.

    Raises:
        DashboardError: naming the part that is missing or wrong.
    """
    _check_names(document, {'formula', 'name', 'every_state', 'margin', 'timeout_s'})
    formula = _part(document, 'formula', str)
    check_length(formula)
    timeout_s = _number(document, 'timeout_s')
    if not (math.isfinite(timeout_s) and 0 < timeout_s <= MAX_TIMEOUT_S):
        raise DashboardError(
            f"'timeout_s' is {timeout_s:g}; give seconds above 0, at most {MAX_TIMEOUT_S:g}"
        )
    return AskedFormula(
        formula,
        named(document, allow_empty=True),
        _part(document, 'every_state', bool),
        _part(document, 'margin', bool),
        timeout_s,
    )


def evaluation_name(document: Mapping[str, Any], *, allow_empty: bool = False) -> str:
    """Return the name in a request that has nothing else.

    Raises:
        DashboardError: naming the part that is missing or wrong.
    """
    _check_names(document, {'name'})
    return named(document, allow_empty=allow_empty)


def interest(document: Mapping[str, Any]) -> Interest:
    """Return what a page shows.

    Raises:
        DashboardError: naming the part that is missing or wrong.
    """
    _check_names(document, {'view', 'opened'})
    view = _part(document, 'view', str)
    opened: list[Any] = _part(document, 'opened', list)
    if view not in VIEWS:
        raise DashboardError(
            f"there is no view '{shortened(view)}' (there are: {', '.join(VIEWS)})"
        )
    if len(opened) > MAX_OPEN:
        raise DashboardError(f'a page may open at most {MAX_OPEN} formulas')
    if not all(isinstance(each, str) and len(each) <= MAX_KEY for each in opened):
        raise DashboardError("'opened' is not a list of keys of evaluations")
    return Interest(view, tuple(dict.fromkeys(opened)))


def failure_ids(document: Mapping[str, Any], *others: str) -> list[int]:
    """Return the failures in a request, given the names of its other parts.

    Raises:
        DashboardError: naming the part that is missing or wrong.
    """
    _check_names(document, {'ids', *others})
    ids: list[Any] = _part(document, 'ids', list)
    if len(ids) > MAX_IDS or not all(type(each) is int and 0 <= each <= LAST for each in ids):
        raise DashboardError(f"'ids' is not a list of the ids of at most {MAX_IDS} failures")
    return ids


def acknowledgement(document: Mapping[str, Any]) -> tuple[list[int], str]:
    """Return the failures in a request, and who has seen them.

    Raises:
        DashboardError: naming the part that is missing or wrong.
    """
    ids, by = failure_ids(document, 'by'), _part(document, 'by', str).strip()
    if not 0 < len(by) <= MAX_OPERATOR:
        raise DashboardError(f"'by' says who has seen them, in 1 to {MAX_OPERATOR} characters")
    return ids, by


def history_query(arguments: Mapping[str, str], limit: int) -> HistoryQuery:
    """Return which failures a request asks for, by its arguments: at most as many as a limit.

    Raises:
        DashboardError: naming the argument that is wrong.
    """

    def number(name: str, default: int, limit: int = LAST) -> int:
        text = arguments.get(name, str(default))
        is_number = text.isascii() and text.isdecimal() and len(text) <= len(str(LAST))
        if not (is_number and int(text) <= limit):
            raise DashboardError(f"'{name}' is no whole number up to {limit}")
        return int(text)

    _check_names(arguments, {'from', 'to', 'name', 'before', 'limit'})
    span = number('from', 0), number('to', LAST)
    name = arguments.get('name', '')
    return HistoryQuery(*span, name, number('before', LAST), number('limit', limit, limit))


def named(document: Mapping[str, Any], *, allow_empty: bool = False) -> str:
    """Return the part `name` of a request.

    Raises:
        DashboardError: if it is missing, empty or too long, or a message cannot hold it.
    """
    name = _part(document, 'name', str)
    if not (name or allow_empty):
        raise DashboardError("'name' is empty")
    if len(name) > MAX_NAME:
        raise DashboardError(f"'name' has {len(name)} characters; give at most {MAX_NAME}")
    return name


def _part(document: Mapping[str, Any], name: str, kind: type[Kind]) -> Kind:
    value = document.get(name)
    # True is an int in Python.
    is_confused = isinstance(value, bool) and kind is not bool
    if not isinstance(value, kind) or is_confused:
        raise DashboardError(f"the request lacks '{name}', or it has the wrong type")
    if isinstance(value, str) and any(_is_unsendable(each) for each in value):
        raise DashboardError(f"'{name}' has a character that no message of ROS can hold")
    return value


def _number(document: Mapping[str, Any], name: str) -> float:
    is_whole = isinstance(document.get(name), int)
    try:
        return float(_part(document, name, int if is_whole else float))
    except OverflowError:
        return math.inf


def _is_unsendable(character: str) -> bool:
    return character == '\0' or '\ud800' <= character <= '\udfff'


def _check_names(document: Mapping[str, Any], known: set[str]) -> None:
    for name in document:
        if name not in known:
            raise DashboardError(
                f"unknown part '{shortened(name)}' (there are: {', '.join(sorted(known))})"
            )


def _refuse_constant(name: str) -> Any:
    raise ValueError(f'{name} is no number of JSON')
