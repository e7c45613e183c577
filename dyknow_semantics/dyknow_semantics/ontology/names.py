"""Short names, prefixed names and IRIs of the entities of an ontology."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Final

from dyknow_common import ExitCode, listed, shortened
from dyknow_semantics.errors import SemanticsError

_MAX_LISTED: Final = 10
"""The number of known names that a message lists if none is similar to an unknown one."""

_MAX_COMPARED: Final = 200
"""The length of a name that is compared with others."""


_MAX_SPELLINGS: Final = 5_000
"""The number of known spellings that an unknown name is compared with: 0.1 s of comparisons."""


def split_iri(iri: str) -> tuple[str, str]:
    """Return the namespace of an IRI, with the final `#` or `/`, and the local name."""
    separator = '#' if '#' in iri else '/'
    namespace, _, local = iri.rpartition(separator)
    return namespace + separator, local


def prefix_of(namespace: str) -> str:
    """Return the default prefix of a namespace: its last part without a file extension."""
    last = namespace.rstrip('#/').rpartition('/')[2]
    return last.removesuffix('.owl').removesuffix('.rdf')


def suggestion(name: str, known: Mapping[str, str]) -> str:
    """Return the end of an error message: known names similar to an unknown one, or all.

    `known` holds the name to suggest for each known spelling.
    """
    # The time to compare two names grows with the product of their lengths.
    spellings = sorted(each for each in known if len(each) <= _MAX_COMPARED)[:_MAX_SPELLINGS]
    similar = get_close_matches(name, spellings, n=6) if len(name) <= _MAX_COMPARED else ()
    near = dict.fromkeys(known[each] for each in similar)
    if near:
        return f'; did you mean {" or ".join(map(repr, list(near)[:3]))}?'
    names = sorted(set(known.values()))
    listed = ', '.join(names[:_MAX_LISTED]) + (', ...' if len(names) > _MAX_LISTED else '')
    return f'; there are: {listed}' if names else '; there is none'


class Prefixes:
    """The prefixes of namespaces.

    A namespace has its default prefix and all declared ones. Several ontologies may declare the
    same prefix: it then stands for all of their namespaces, and a prefixed name is valid if it
    exists in only one of them.

    Args:
        declared: pairs of a namespace and a prefix of it.
    """

    def __init__(self, declared: Iterable[tuple[str, str]] = ()) -> None:
        self._prefixes: dict[str, set[str]] = defaultdict(set)
        for namespace, prefix in declared:
            self._prefixes[namespace].add(prefix)

    def of(self, namespace: str) -> tuple[str, ...]:
        """Return the prefixes of a namespace: the default one, then the others by name."""
        default = prefix_of(namespace)
        return default, *sorted(self._prefixes.get(namespace, set()) - {default})

    def namespace(self, prefix: str, namespaces: Iterable[str]) -> str:
        """Return the namespace with a prefix, from `namespaces` or the declared namespaces.

        Raises:
            SemanticsError: if none or several have the prefix.
        """
        known = {*namespaces, *self._prefixes}
        found = sorted(each for each in known if prefix in self.of(each))
        if len(found) > 1:
            candidates = ' and '.join(found[:_MAX_LISTED])
            raise SemanticsError(
                f"the prefix '{shortened(prefix)}' is ambiguous; it stands for {candidates}: "
                'give the whole IRI'
            )
        if not found:
            hint = suggestion(prefix, {name: name for each in known for name in self.of(each)})
            raise SemanticsError(
                f"no ontology with the prefix '{shortened(prefix)}' is loaded{hint}",
                ExitCode.NOT_FOUND,
            )
        return found[0]


class Names:
    """The names of all entities of one kind.

    An entity has a short name (`Altitude`), prefixed names (`uav:Altitude`), and its IRI
    (`http://www.dyknow.org/uav#Altitude`). A name that several entities share is ambiguous.

    Args:
        kind: the kind of the entities in messages.
    """

    def __init__(self, kind: str, iris: Iterable[str], prefixes: Prefixes | None = None) -> None:
        self._kind = kind
        self._prefixes = prefixes or Prefixes()
        self._iris: dict[str, set[str]] = defaultdict(set)
        for iri in iris:
            for name in self._names_of(iri):
                self._iris[name].add(iri)

    def __contains__(self, name: str) -> bool:
        """Return True if at least one entity has the name."""
        return name in self._iris

    def iri(self, name: str) -> str:
        """Return the IRI of the only entity with a name.

        Raises:
            SemanticsError: if no entity has the name (NOT_FOUND, with similar names), or several.
        """
        iris = self._iris.get(name, ())
        if len(iris) > 1:
            candidates = listed(sorted(map(self.name, iris)))
            raise SemanticsError(
                f"the {self._kind} '{shortened(name)}' is ambiguous; it is one of {candidates}; "
                'formulas have no prefixes: to name it there, rename it in all ontologies but one'
            )
        if not iris:
            known = {each: self.name(iri) for each, same in self._iris.items() for iri in same}
            hint = suggestion(name, known)
            message = f"unknown {self._kind} '{shortened(name)}'{hint}"
            raise SemanticsError(message, ExitCode.NOT_FOUND)
        return next(iter(iris))

    def name(self, iri: str) -> str:
        """Return the shortest unambiguous name of an entity."""
        return next(name for name in self._names_of(iri) if len(self._iris[name]) == 1)

    def _names_of(self, iri: str) -> Iterator[str]:
        namespace, local = split_iri(iri)
        yield local
        for prefix in self._prefixes.of(namespace):
            yield f'{prefix}:{local}'
        yield iri
