"""Reasoners for the whole of OWL: HermiT and Pellet.

A reasoner takes seconds to minutes. It runs in a worker process, where owlready2 starts it in Java.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from io import BytesIO
from typing import Any, Final, NoReturn, cast

import owlready2
import owlready2.reasoning
from owlready2.base import OwlReadyInconsistentOntologyError, OwlReadyJavaError

from dyknow_common import ExitCode, listed
from dyknow_common.worker_pool import WorkerPool
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology import vocabulary
from dyknow_semantics.ontology.documents.documents import suppressed_output
from dyknow_semantics.ontology.knowledge import Triple
from dyknow_semantics.workers import Work

_MEMORY: Final = 2 * 1024**3
_ENTAILED: Final = 'http://entailed/'
_TYPE: Final = f'<{vocabulary.TYPE}>'.encode()
_INDIVIDUAL: Final = f'<{vocabulary.NAMED_INDIVIDUAL}>'.encode()
_LANGUAGES: Final = tuple(f'<{language}'.encode() for language in vocabulary.LANGUAGES)


class Reasoner(StrEnum):
    """The choice of the statements that are derived from an ontology."""

    STRUCTURAL = 'structural'
    """Only the consequences of the order of concepts, which `Knowledge` computes."""

    HERMIT = 'hermit'
    PELLET = 'pellet'

    @classmethod
    def _missing_(cls, value: object) -> NoReturn:
        known = ', '.join(cls)
        raise SemanticsError(f"unknown reasoner '{value}'; choose one of {known}")


@dataclass(frozen=True, slots=True)
class Draft:
    """A version of an ontology for a reasoner.

    Args:
        revision: the revision of the ontology when the draft was made.
        text: N-Triples without entailed statements.
        name: returns the name of the entity with an IRI.
    """

    revision: int
    text: bytes
    name: Callable[[str], str]


class ReasonerProcess:
    """A reasoner that runs in a worker process.

    Args:
        reasoner: HermiT or Pellet.
        limit_s: the longest time for one ontology.
        memory: the number of bytes that Java may use for objects.

    Raises:
        SemanticsError: UNAVAILABLE, if Java is not installed.
    """

    def __init__(self, reasoner: Reasoner, limit_s: float, memory: int = _MEMORY) -> None:
        if shutil.which('java') is None:
            raise SemanticsError(
                f"the reasoner '{reasoner}' needs Java, which is not installed; install it (on "
                "Debian and Ubuntu: apt install default-jre-headless) or choose 'structural'",
                ExitCode.UNAVAILABLE,
            )
        self._reasoner = reasoner
        self._limit_s = limit_s
        self._memory = memory
        # Java reserves more address space than memory, so an option of Java limits its objects.
        self._pool = WorkerPool(1, is_silent=True)

    def stop(self) -> None:
        """Stop the reasoner for good; another thread may be waiting in `infer`."""
        self._pool.stop()

    def infer(self, draft: Draft) -> tuple[Triple, ...]:
        """Return the entailed subclasses, equivalent classes and classes of individuals.

        Raises:
            SemanticsError: if the ontology is inconsistent or has unsatisfiable classes, which the
                message names; UNAVAILABLE, if the reasoner fails; TIMEOUT, if it takes too long.
        """
        answer = Work(
            classify,
            (draft.text, str(self._reasoner), self._memory),
            f"the reasoner '{self._reasoner}'",
            self._limit_s,
            'increase reasoning_limit or choose another reasoner',
        ).run(self._pool)
        if answer['inconsistent'] or answer['unsatisfiable']:
            unsatisfiable = sorted(map(draft.name, answer['unsatisfiable']))
            raise _contradiction(unsatisfiable, consistent=not answer['inconsistent'])
        return tuple(cast('Triple', tuple(triple)) for triple in answer['entailed'])


def _contradiction(unsatisfiable: list[str], *, consistent: bool) -> SemanticsError:
    fault = '' if consistent else 'the ontology is inconsistent: '
    if not unsatisfiable:
        return SemanticsError(
            f'{fault}every class is satisfiable, but the statements about individuals contradict '
            'each other; look for an individual of disjoint classes'
        )
    return SemanticsError(
        f'{fault}no individual can belong to the unsatisfiable classes '
        f'{listed(unsatisfiable)}; correct their definitions'
    )


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
