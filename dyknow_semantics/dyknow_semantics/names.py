"""Names of things in an ontology: short, prefixed and full."""

from __future__ import annotations

from collections import defaultdict
from difflib import get_close_matches
from typing import TYPE_CHECKING, Final

from dyknow_semantics.errors import SemanticsError
from dyknow_stream_processing import ExitCode

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

_LISTED: Final = 10
"""So many known names are listed where none is near an unknown one."""


def split_iri(iri: str) -> tuple[str, str]:
    """The namespace of an IRI, with its `#` or `/` at the end, and the local name."""
    separator = '#' if '#' in iri else '/'
    namespace, _, local = iri.rpartition(separator)
    return namespace + separator, local


def prefix_of(namespace: str) -> str:
    """The prefix that stands for a namespace: the last part of it, without a file's ending."""
    last = namespace.rstrip('#/').rpartition('/')[2]
    return last.removesuffix('.owl').removesuffix('.rdf')


def suggestion(name: str, known: Mapping[str, str]) -> str:
    """The end of an error message: what was perhaps meant by an unknown name.

    Args:
        name: the unknown name.
        known: for each known spelling, the name to suggest.
    """
    near = dict.fromkeys(known[each] for each in get_close_matches(name, sorted(known), n=6))
    if near:
        return f'; did you mean {" or ".join(map(repr, list(near)[:3]))}?'
    names = sorted(set(known.values()))
    listed = ', '.join(names[:_LISTED]) + (', ...' if len(names) > _LISTED else '')
    return f'; there are: {listed}' if names else '; there is none'


class Names:
    """The names of all things of one kind.

    A thing goes by its short name (`Altitude`), by prefix and short name (`uav:Altitude`), and by
    its IRI (`http://www.dyknow.org/uav#Altitude`). A name that several things share names none.

    Args:
        kind: what the things are called in messages.
        iris: the IRIs of the things.
    """

    def __init__(self, kind: str, iris: Iterable[str]) -> None:
        self._kind = kind
        self._bearers: dict[str, set[str]] = defaultdict(set)
        for iri in iris:
            for name in _spellings(iri):
                self._bearers[name].add(iri)

    def __contains__(self, name: str) -> bool:
        """Whether at least one thing bears the name."""
        return name in self._bearers

    def iri(self, name: str) -> str:
        """The IRI of the one thing that bears a name.

        Raises:
            SemanticsError: if nothing bears it, with names that are near, or several things do.
        """
        bearers = self._bearers.get(name, ())
        if len(bearers) > 1:
            candidates = ', '.join(sorted(map(self.name, bearers)))
            raise SemanticsError(
                f"the {self._kind} '{name}' is ambiguous; it is one of {candidates}"
            )
        if not bearers:
            known = {each: self.name(iri) for each, iris in self._bearers.items() for iri in iris}
            hint = suggestion(name, known)
            raise SemanticsError(f"unknown {self._kind} '{name}'{hint}", ExitCode.NOT_FOUND)
        return next(iter(bearers))

    def name(self, iri: str) -> str:
        """The shortest name that only this thing bears."""
        return next(name for name in _spellings(iri) if len(self._bearers[name]) == 1)


def _spellings(iri: str) -> tuple[str, str, str]:
    namespace, local = split_iri(iri)
    return local, f'{prefix_of(namespace)}:{local}', iri
