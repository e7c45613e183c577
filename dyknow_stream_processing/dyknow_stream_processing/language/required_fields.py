"""The fields of topics that streams need."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from dyknow_stream_processing.language.built_in_sources import TF_STATIC
from dyknow_stream_processing.language.specification import (
    BuiltIn,
    BuiltInSource,
    Call,
    Select,
    StreamReference,
    Sync,
    Term,
)

Demand = frozenset[str]
"""Names of fields."""

ALL: Final = '*'
"""A name for all fields except the elements of arrays, which are named one by one."""

WHOLE: Final = '**'
"""A name for the whole message, which built-in sources read."""


def total_demand(terms: Iterable[Term]) -> Mapping[str, Demand]:
    """Return the fields of each topic that resolved streams need."""
    return joined_demands(each for term in terms for each in _demands(term, frozenset({ALL})))


def joined_demands(demands: Iterable[tuple[str, Demand]]) -> Mapping[str, Demand]:
    """Return all needed fields of each topic, given some needed fields of topics."""
    total: dict[str, Demand] = {}
    for topic, demand in demands:
        total[topic] = total.get(topic, frozenset()) | demand
    return total


def _demands(term: Term, wanted: Demand) -> Iterator[tuple[str, Demand]]:
    if isinstance(term, StreamReference):
        yield term.name, wanted
    elif isinstance(term, BuiltInSource):
        needed: Demand = frozenset() if term.kind is BuiltIn.RATE else frozenset({WHOLE})
        for each in term.inputs:
            yield from _demands(each, needed)
        if term.kind is BuiltIn.TF:
            yield TF_STATIC, frozenset({WHOLE})
    elif isinstance(term, Select):
        yield from _demands(term.source, term.demand)
    elif isinstance(term, Call) and term.declaration is not None:
        for each, parameter in zip(term.inputs, term.declaration.parameters, strict=True):
            yield from _demands(each, frozenset(field.name for field in parameter))
    else:
        # It is not always known which input of a sync has a field.
        for each in term.inputs:
            yield from _demands(each, wanted | {ALL} if isinstance(term, Sync) else wanted)
