"""The program that asks a reasoner: an ontology in N-Triples comes in, a JSON text goes out."""

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

from dyknow_semantics.ontology.vocabulary import (
    EQUIVALENT_CLASS,
    LANGUAGES,
    NAMED_INDIVIDUAL,
    NOTHING,
    SUBCLASS_OF,
    THING,
    TYPE,
)

_LOOK_EVERY: Final = 0.5
"""Seconds between two looks for the parent process."""

_ENTAILED: Final = 'http://entailed/'
_TYPE: Final = f'<{TYPE}>'.encode()
_INDIVIDUAL: Final = f'<{NAMED_INDIVIDUAL}>'.encode()
_LANGUAGES: Final = tuple(f'<{language}'.encode() for language in LANGUAGES)


def classify(text: bytes, reasoner: str) -> dict[str, Any]:
    """What an ontology entails, or why it entails everything.

    Raises:
        OwlReadyJavaError: if the reasoner fails.
    """
    try:
        world = _reason(text, reasoner)
    except OwlReadyInconsistentOntologyError:
        return {'inconsistent': True, 'unsatisfiable': _culprits(text, reasoner), 'entailed': []}
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


def _culprits(text: bytes, reasoner: str) -> list[str]:
    """The classes that are unsatisfiable whatever individuals there are."""
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
    return sorted(each.iri for each in world.inconsistent_classes() if each.iri != NOTHING)


def _entailed(world: Any) -> list[tuple[str, ...]]:
    graph = world.get_ontology(_ENTAILED).graph
    rows = graph.execute('SELECT s, p, o FROM objs WHERE c = ? AND s > 0 AND o > 0', (graph.c,))
    name = world._unabbreviate  # noqa: SLF001 - nothing public does it
    triples = (tuple(map(name, row)) for row in rows.fetchall())
    return [
        (subject, predicate, value)
        for subject, predicate, value in triples
        if predicate in {SUBCLASS_OF, EQUIVALENT_CLASS, TYPE}
        and subject != _ENTAILED.rstrip('/')
        and not {subject, value} & {THING, NOTHING}
    ]


def _end_with(parent: int) -> None:
    """Ends this process and Java when whoever wants the answer has died."""
    while os.getppid() == parent:
        threading.Event().wait(_LOOK_EVERY)
    os.killpg(0, signal.SIGKILL)


def main() -> int:
    """Answers on the standard output; the exit code is 1 when the reasoner has failed.

    It is to be started in a process group of its own, which ends with it.
    """
    threading.Thread(target=_end_with, args=(os.getppid(),), daemon=True).start()
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
