"""Reasoners for the whole of OWL: HermiT and Pellet.

A reasoner takes seconds to minutes. It runs in a worker process, where owlready2 starts it in Java.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, NoReturn, cast

from dyknow_common import ExitCode, listed
from dyknow_common.worker_pool import WorkerPool
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.classification import classify
from dyknow_semantics.ontology.knowledge import Triple
from dyknow_semantics.workers import Work

_MEMORY: Final = 2 * 1024**3


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
        # Java reserves more addresses than it uses memory, so its own option limits its objects.
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
