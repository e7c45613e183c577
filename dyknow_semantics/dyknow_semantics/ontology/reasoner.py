"""Reasoners for the whole of OWL: HermiT and Pellet.

A reasoner takes seconds to minutes. It runs in a separate process, `reasoner_program`, where
owlready2 starts it in Java.
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
from typing import Final, NoReturn, cast

from dyknow_common import ExitCode
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.knowledge import Triple

_PROGRAM: Final = 'dyknow_semantics.ontology.reasoner_program'
_MAX_LISTED: Final = 20
"""The number of unsatisfiable classes that a message names."""


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
    """A reasoner that runs in a separate process.

    Args:
        reasoner: HermiT or Pellet.
        limit_s: the longest time for one ontology.

    Raises:
        SemanticsError: UNAVAILABLE, if Java is not installed.
    """

    def __init__(self, reasoner: Reasoner, limit_s: float) -> None:
        if shutil.which('java') is None:
            raise SemanticsError(
                f"the reasoner '{reasoner}' needs Java, which is not installed; install it (on "
                "Debian and Ubuntu: apt install default-jre-headless) or choose 'structural'",
                ExitCode.UNAVAILABLE,
            )
        self._reasoner = reasoner
        self._limit_s = limit_s
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False

    def stop(self) -> None:
        """Stop the reasoner for good; another thread may be waiting in `infer`."""
        self._stopped = True
        self._kill()

    def infer(self, draft: Draft) -> tuple[Triple, ...]:
        """Return the entailed subclasses, equivalent classes and classes of individuals.

        Raises:
            SemanticsError: if the ontology is inconsistent or has unsatisfiable classes, which the
                message names; UNAVAILABLE, if the reasoner fails; TIMEOUT, if it takes too long.
        """
        with subprocess.Popen(
            [sys.executable, '-m', _PROGRAM, self._reasoner],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            start_new_session=True,  # Java is in the same process group and is killed with it.
        ) as self._process:
            if self._stopped:
                self._kill()
            try:
                output, errors = self._process.communicate(draft.text, self._limit_s)
            except subprocess.TimeoutExpired:
                self._kill()
                raise SemanticsError(
                    f"the reasoner '{self._reasoner}' did not finish within {self._limit_s:g} s; "
                    'increase reasoning_limit or choose another reasoner',
                    ExitCode.TIMEOUT,
                ) from None
        if self._process.returncode != 0:
            raise self._failure(errors.decode(errors='replace'))
        answer = json.loads(output)
        if answer['inconsistent'] or answer['unsatisfiable']:
            unsatisfiable = sorted(map(draft.name, answer['unsatisfiable']))
            raise _contradiction(unsatisfiable, consistent=not answer['inconsistent'])
        return tuple(cast('Triple', tuple(triple)) for triple in answer['entailed'])

    def _kill(self) -> None:
        if self._process is not None and self._process.poll() is None:
            with suppress(ProcessLookupError):
                os.killpg(self._process.pid, signal.SIGKILL)

    def _failure(self, errors: str) -> SemanticsError:
        lines = errors.strip().splitlines() or ['it printed no error message']
        if self._stopped:
            lines = ['it was stopped']
        mend = (
            '; install a newer Java or choose another reasoner'
            if 'UnsupportedClassVersionError' in errors
            else ''
        )
        return SemanticsError(
            f"the reasoner '{self._reasoner}' has failed: {lines[-1]}{mend}", ExitCode.UNAVAILABLE
        )


def _contradiction(unsatisfiable: list[str], *, consistent: bool) -> SemanticsError:
    fault = '' if consistent else 'the ontology is inconsistent: '
    if not unsatisfiable:
        return SemanticsError(
            f'{fault}every class is satisfiable, but the statements about individuals contradict '
            'each other; look for an individual of disjoint classes'
        )
    more = ', ...' if len(unsatisfiable) > _MAX_LISTED else ''
    return SemanticsError(
        f'{fault}no individual can belong to the unsatisfiable classes '
        f'{", ".join(unsatisfiable[:_MAX_LISTED])}{more}; correct their definitions'
    )
