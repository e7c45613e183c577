"""What follows from an ontology by a reasoner for the whole of OWL (HermiT or Pellet).

A reasoner takes seconds to minutes: it runs in a process of its own, which is this module as a
program, and owlready2 there starts Java.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from enum import StrEnum
from typing import Final, cast

from dyknow_common import ExitCode
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.knowledge import Triple

_PROGRAM: Final = 'dyknow_semantics.ontology.reasoner_program'
_LISTED: Final = 20
"""So many unsatisfiable classes are named in a message."""


class Reasoner(StrEnum):
    """What tells which concepts lie below which, and which instances belong to them."""

    STRUCTURAL = 'structural'
    """What is stated, and what follows by the order of the concepts alone."""

    HERMIT = 'hermit'
    PELLET = 'pellet'


def choose_reasoner(name: str) -> Reasoner:
    """The reasoner of a name.

    Raises:
        SemanticsError: if there is none.
    """
    try:
        return Reasoner(name)
    except ValueError:
        known = ', '.join(Reasoner)
        raise SemanticsError(f"unknown reasoner '{name}'; choose one of {known}") from None


@dataclass(frozen=True, slots=True)
class Draft:
    """An ontology as it is or would be.

    Args:
        revision: how many changes the ontology has seen before.
        text: what it says in N-Triples, without what is entailed.
        name: what the thing of an IRI is called in it.
    """

    revision: int
    text: bytes
    name: Callable[[str], str]


class ReasonerProcess:
    """A reasoner that is asked what follows from a text.

    Args:
        reasoner: HermiT or Pellet.
        limit: how long it may take, in seconds.

    Raises:
        SemanticsError: UNAVAILABLE, if Java is not installed.
    """

    def __init__(self, reasoner: Reasoner, limit: float) -> None:
        if shutil.which('java') is None:
            raise SemanticsError(
                f"the reasoner '{reasoner}' needs Java, which is not installed; install it (on "
                "Debian and Ubuntu: apt install default-jre-headless) or choose 'structural'",
                ExitCode.UNAVAILABLE,
            )
        self._reasoner = reasoner
        self._limit = limit
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False

    def stop(self) -> None:
        """Ends it for good; may be called while another thread waits for an answer."""
        self._stopped = True
        self._kill()

    def entailed(self, draft: Draft) -> tuple[Triple, ...]:
        """The subclasses, equivalent classes and classes of individuals that an ontology entails.

        Args:
            draft: the ontology.

        Raises:
            SemanticsError: if the ontology is inconsistent or a class of it cannot have instances,
                with the names of such classes; UNAVAILABLE, if the reasoner fails; TIMEOUT, if it
                takes too long.
        """
        with subprocess.Popen(
            [sys.executable, '-m', _PROGRAM, self._reasoner],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # so that Java ends with it
        ) as self._process:
            if self._stopped:
                self._kill()
            try:
                output, complaint = self._process.communicate(draft.text, self._limit)
            except subprocess.TimeoutExpired:
                self._kill()
                raise SemanticsError(
                    f"the reasoner '{self._reasoner}' has found no answer within "
                    f'{self._limit:g} s; give it more (reasoning_limit) or choose another',
                    ExitCode.TIMEOUT,
                ) from None
        if self._process.returncode != 0:
            raise self._failure(complaint.decode(errors='replace'))
        answer = json.loads(output)
        if answer['inconsistent'] or answer['unsatisfiable']:
            unsatisfiable = sorted(map(draft.name, answer['unsatisfiable']))
            raise _contradiction(unsatisfiable, consistent=not answer['inconsistent'])
        return tuple(cast('Triple', tuple(triple)) for triple in answer['entailed'])

    def _kill(self) -> None:
        if self._process is not None and self._process.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)

    def _failure(self, complaint: str) -> SemanticsError:
        lines = complaint.strip().splitlines() or ['it says nothing of why']
        if self._stopped:
            lines = ['it was stopped']
        mend = (
            '; install a newer Java or choose another reasoner'
            if 'UnsupportedClassVersionError' in complaint
            else ''
        )
        return SemanticsError(
            f"the reasoner '{self._reasoner}' has failed: {lines[-1]}{mend}", ExitCode.UNAVAILABLE
        )


def _contradiction(unsatisfiable: list[str], *, consistent: bool) -> SemanticsError:
    """Why an ontology is refused."""
    fault = '' if consistent else 'the ontology is inconsistent: '
    named = ', '.join(unsatisfiable[:_LISTED]) + (', ...' if len(unsatisfiable) > _LISTED else '')
    if unsatisfiable:
        return SemanticsError(
            f'{fault}no individual can belong to the unsatisfiable classes {named}; '
            'correct what is said of them'
        )
    return SemanticsError(
        f'{fault}each class can have individuals, but what is said of individuals contradicts '
        'itself; look for one that belongs to disjoint classes'
    )
