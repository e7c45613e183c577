"""Classification of an ontology by a reasoner, which owlready2 starts in Java."""

from __future__ import annotations

from io import BytesIO
from typing import Any, Final

import owlready2
import owlready2.reasoning
from owlready2.base import OwlReadyInconsistentOntologyError, OwlReadyJavaError

from dyknow_common import ExitCode
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology import vocabulary
from dyknow_semantics.ontology.documents.documents import suppressed_output

_ENTAILED: Final = 'http://entailed/'
_TYPE: Final = f'<{vocabulary.TYPE}>'.encode()
_INDIVIDUAL: Final = f'<{vocabulary.NAMED_INDIVIDUAL}>'.encode()
_LANGUAGES: Final = tuple(f'<{language}'.encode() for language in vocabulary.LANGUAGES)


def classify(text: bytes, reasoner: str, memory: int) -> dict[str, Any]:
    """Return the statements that an ontology entails, or its unsatisfiable classes.

    Args:
        text: N-Triples.
        reasoner: `hermit` or `pellet`.
        memory: the bytes that Java may use for objects.

    Raises:
        SemanticsError: UNAVAILABLE, if the reasoner fails.
    """
    owlready2.reasoning.JAVA_MEMORY = memory // 1024**2
    try:
        with suppressed_output():
            return _classified(text, reasoner)
    except OwlReadyJavaError as error:
        _, exception, *_ = [*str(error).splitlines(), '', '']
        raise SemanticsError(_failure(reasoner, exception), ExitCode.UNAVAILABLE) from None


def _failure(reasoner: str, exception: str) -> str:
    mend = ''
    if 'UnsupportedClassVersionError' in exception:
        mend = '; install a newer Java or choose another reasoner'
    elif 'OutOfMemoryError' in exception:
        mend = '; increase worker_memory or choose another reasoner'
    reason = exception or 'it printed no error message'
    return f"the reasoner '{reasoner}' has failed: {reason}{mend}"


def _classified(text: bytes, reasoner: str) -> dict[str, Any]:
    try:
        world = _reason(text, reasoner)
    except OwlReadyInconsistentOntologyError:
        unsatisfiable = _unsatisfiable_without_individuals(text, reasoner)
        return {'inconsistent': True, 'unsatisfiable': unsatisfiable, 'entailed': []}
    unsatisfiable = _unsatisfiable(world)
    return {
        'inconsistent': False,
        'unsatisfiable': unsatisfiable,
        'entailed': [] if unsatisfiable else _entailed(world),
    }


def _reason(text: bytes, reasoner: str) -> Any:
    world = owlready2.World()
    world.get_ontology('http://stated/').graph.parse(BytesIO(text), format='ntriples')
    with world.get_ontology(_ENTAILED):
        if reasoner == 'hermit':
            owlready2.sync_reasoner_hermit(world, debug=0, ignore_unsupported_datatypes=True)
        else:
            owlready2.sync_reasoner_pellet(world, debug=0)
    return world


def _unsatisfiable_without_individuals(text: bytes, reasoner: str) -> list[str]:
    """Return the classes that are unsatisfiable even if all individuals are removed."""
    lines = [(line.split(b' ', 2), line) for line in text.splitlines(keepends=True)]
    individuals = {
        subject
        for (subject, predicate, kind), _ in lines
        if predicate == _TYPE and (not kind.startswith(_LANGUAGES) or kind.startswith(_INDIVIDUAL))
    }
    classes = (line for (subject, *_), line in lines if subject not in individuals)
    try:
        return _unsatisfiable(_reason(b''.join(classes), reasoner))
    except OwlReadyInconsistentOntologyError:
        return []


def _unsatisfiable(world: Any) -> list[str]:
    return sorted(
        each.iri for each in world.inconsistent_classes() if each.iri != vocabulary.NOTHING
    )


def _entailed(world: Any) -> list[tuple[str, ...]]:
    graph = world.get_ontology(_ENTAILED).graph
    rows = graph.execute('SELECT s, p, o FROM objs WHERE c = ? AND s > 0 AND o > 0', (graph.c,))
    name = world._unabbreviate  # noqa: SLF001 - no public equivalent
    triples = (tuple(map(name, row)) for row in rows.fetchall())
    return [
        (subject, predicate, value)
        for subject, predicate, value in triples
        if predicate in {vocabulary.SUBCLASS_OF, vocabulary.EQUIVALENT_CLASS, vocabulary.TYPE}
        and subject != _ENTAILED.rstrip('/')
        and not {subject, value} & {vocabulary.THING, vocabulary.NOTHING}
    ]
