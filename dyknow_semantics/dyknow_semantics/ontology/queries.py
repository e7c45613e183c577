"""Answers of SPARQL queries, from a copy of the store.

A query may take for ever, or all memory. The ontology manager answers it in a worker process, which
is killed at its limits.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any, Final

import owlready2

from dyknow_common import shortened
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.documents.documents import suppressed_output

MAX_SOLUTIONS: Final = 100_000
MAX_QUERY: Final = 100_000
"""The length of a query, in characters."""

_MAX_ANSWER: Final = 16 * 1024 * 1024
"""The length of an answer, in characters."""


@dataclass(frozen=True, slots=True)
class Solutions:
    """The solutions of a query.

    Args:
        variables: the names of the variables.
        values: row by row.
        resources: for each value 1 if it is the IRI of a resource, otherwise 0.
    """

    variables: tuple[str, ...]
    values: list[str]
    resources: bytes


def check_query(sparql: str) -> None:
    """Check the length of a query.

    Raises:
        SemanticsError: if it is too long.
    """
    if len(sparql) > MAX_QUERY:
        raise SemanticsError(f'the SPARQL query has more than {MAX_QUERY:,} characters; shorten it')


def answer_query(store: Path, sparql: str, max_solutions: int) -> Solutions:
    """Return the solutions of a SPARQL SELECT query.

    Args:
        store: the file of a store, which is not changed.
        sparql: the query.
        max_solutions: the number of solutions that it may have.

    Raises:
        SemanticsError: if the query is malformed, changes something or has too many solutions.
    """
    world = owlready2.World(filename=str(store), exclusive=False, read_only=True)
    try:
        with suppressed_output():
            return _solutions(world, sparql, max_solutions)
    except (SemanticsError, MemoryError, RecursionError):
        raise
    except Exception as error:  # noqa: BLE001 - owlready2 raises any, at malformed queries
        reason = shortened(getattr(error, 'message', error) or type(error).__name__)
        raise SemanticsError(f'the SPARQL query cannot be answered: {reason}') from None
    finally:
        world.close()


def _solutions(world: Any, sparql: str, max_solutions: int) -> Solutions:
    # The nodes, which start no query of their own, need not make the tables of its parser.
    from owlready2.sparql.main import PreparedSelectQuery  # noqa: PLC0415

    query = world.prepare_sparql(sparql)
    if not isinstance(query, PreparedSelectQuery):
        raise SemanticsError('only SELECT queries are answered')
    values: list[str] = []
    resources = bytearray()
    length = 0
    rows = islice(_rows(world, query), max_solutions + 1)
    for number, row in enumerate(rows, 1):
        for text, is_resource in row:
            values.append(text)
            resources.append(is_resource)
            length += len(text)
        if number > max_solutions:
            raise SemanticsError(
                f'the SPARQL query has more than {max_solutions:,} solutions; add a LIMIT'
            )
        if length > _MAX_ANSWER:
            raise SemanticsError(
                f'the solutions of the SPARQL query have more than {_MAX_ANSWER:,} characters; '
                'ask for fewer'
            )
    variables = tuple(variable.removeprefix('?') for variable in query.column_names)
    return Solutions(variables, values, bytes(resources))


def _rows(world: Any, query: Any) -> Iterator[list[tuple[str, bool]]]:
    for columns in query.execute_raw():
        # A column of type `objs` holds a resource; other values are followed by their datatype.
        typed = iter(zip(query.column_types, columns, strict=True))
        yield [
            _text(world, value, 'o' if kind == 'objs' else next(typed)[1]) for kind, value in typed
        ]


def _text(world: Any, value: Any, datatype: object) -> tuple[str, bool]:
    """Return the text of a value, and True if it is the IRI of a resource."""
    if value is None:
        return '', False
    if datatype == 'o' and value > 0:
        return world._unabbreviate(value), True  # noqa: SLF001 - no public equivalent
    return str(value), False
