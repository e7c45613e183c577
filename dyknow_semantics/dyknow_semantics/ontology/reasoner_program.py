"""The program that runs a reasoner: it reads an ontology in N-Triples and prints JSON."""

from __future__ import annotations

import json
import os
import signal
import sys
import threading
from contextlib import redirect_stdout
from io import BytesIO
from typing import Any, Final

import owlready2
from owlready2.base import OwlReadyInconsistentOntologyError, OwlReadyJavaError

from dyknow_semantics.ontology import vocabulary

_PARENT_CHECK_PERIOD_S: Final = 0.5
_ENTAILED: Final = 'http://entailed/'
_TYPE: Final = f'<{vocabulary.TYPE}>'.encode()
_INDIVIDUAL: Final = f'<{vocabulary.NAMED_INDIVIDUAL}>'.encode()
_LANGUAGES: Final = tuple(f'<{language}'.encode() for language in vocabulary.LANGUAGES)


def classify(text: bytes, reasoner: str) -> dict[str, Any]:
    """Return the statements that an ontology entails, or its unsatisfiable classes.

    Raises:
        OwlReadyJavaError: if the reasoner fails.
    """
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


def _exit_with(parent: int) -> None:
    """Kill this process and Java when the parent process has died."""
    while os.getppid() == parent:
        threading.Event().wait(_PARENT_CHECK_PERIOD_S)
    os.killpg(0, signal.SIGKILL)


def main() -> int:
    """Run the reasoner that the first argument names; the exit code is 1 if it fails.

    The process must lead a process group of its own, which is killed if the parent dies.
    """
    threading.Thread(target=_exit_with, args=(os.getppid(),), daemon=True).start()
    try:
        with redirect_stdout(sys.stderr):
            answer = classify(sys.stdin.buffer.read(), sys.argv[1])
    except OwlReadyJavaError as error:
        _, exception, *_ = [*str(error).splitlines(), '', '']
        print(exception, file=sys.stderr)  # noqa: T201 - this is a program
        return 1
    print(json.dumps(answer))  # noqa: T201
    return 0


if __name__ == '__main__':
    sys.exit(main())
