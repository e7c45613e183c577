"""Names of things in an ontology: short, prefixed and full."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Final

from dyknow_common import ExitCode
from dyknow_semantics.errors import SemanticsError

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


class Prefixes:
    """What namespaces are called in prefixed names.

    A namespace goes by the last part of its IRI and by all that is declared for it. Nothing keeps
    several ontologies from taking the same prefix: it then stands for all of their namespaces, as
    long as the whole name fits in one of them.

    Args:
        declared: namespaces, each with a prefix of it.
    """

    def __init__(self, declared: Iterable[tuple[str, str]] = ()) -> None:
        self._prefixes: dict[str, set[str]] = defaultdict(set)
        for namespace, prefix in declared:
            self._prefixes[namespace].add(prefix)

    def of(self, namespace: str) -> tuple[str, ...]:
        """The prefixes of a namespace: first the last part of its IRI, then others by name."""
        own = prefix_of(namespace)
        return own, *sorted(self._prefixes.get(namespace, set()) - {own})

    def namespace(self, prefix: str, namespaces: Iterable[str]) -> str:
        """The one of several namespaces that a prefix stands for.

        Raises:
            SemanticsError: if it stands for none or for several of them.
        """
        known = {*namespaces, *self._prefixes}
        found = sorted(each for each in known if prefix in self.of(each))
        if len(found) > 1:
            raise SemanticsError(
                f"the prefix '{prefix}' is ambiguous; it stands for {' and '.join(found)}: "
                'give the whole IRI'
            )
        if not found:
            hint = suggestion(prefix, {name: name for each in known for name in self.of(each)})
            raise SemanticsError(
                f"no ontology with the prefix '{prefix}' is loaded{hint}", ExitCode.NOT_FOUND
            )
        return found[0]


class Names:
    """The names of all things of one kind.

    A thing goes by its short name (`Altitude`), by prefix and short name (`uav:Altitude`), and by
    its IRI (`http://www.dyknow.org/uav#Altitude`). A name that several things share names none.

    Args:
        kind: what the things are called in messages.
        iris: the IRIs of the things.
        prefixes: those of their namespaces.
    """

    def __init__(self, kind: str, iris: Iterable[str], prefixes: Prefixes | None = None) -> None:
        self._kind = kind
        self._prefixes = prefixes or Prefixes()
        self._bearers: dict[str, set[str]] = defaultdict(set)
        for iri in iris:
            for name in self._spellings(iri):
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
        return next(name for name in self._spellings(iri) if len(self._bearers[name]) == 1)

    def _spellings(self, iri: str) -> Iterator[str]:
        namespace, local = split_iri(iri)
        yield local
        for prefix in self._prefixes.of(namespace):
            yield f'{prefix}:{local}'
        yield iri
