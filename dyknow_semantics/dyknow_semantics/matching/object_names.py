"""What objects are called by whoever speaks of them, across ontologies."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

from dyknow_semantics.ontology.knowledge import Knowledge


class ObjectNames:
    """The names of objects, as an ontology that speaks of their sort has them.

    Args:
        stated: what each ontology says by itself.
        bridged: the same, and what bridges between the ontologies add.
    """

    def __init__(self, stated: Knowledge, bridged: Knowledge) -> None:
        self._stated = stated
        self._bridged = bridged
        self._identities: dict[str, frozenset[str]] = {}
        self._members: dict[str, Mapping[str, tuple[str, ...]]] = {}

    def identities(self, sort: str) -> frozenset[str]:
        """The objects that a sort has where it comes from, whatever is bridged into it."""
        if sort not in self._identities:
            objects = self._stated.instances(sort)
            self._identities[sort] = frozenset(map(self._bridged.identity, objects))
        return self._identities[sort]

    def names(self, sort: str, identity: str) -> tuple[str, ...]:
        """The names that an object of a sort has where the sort comes from; at least one."""
        return self._names_in(sort).get(identity, (identity,))

    def datum(self, sort: str, identity: str) -> str:
        """What the samples of a stream call an object of a sort: its short name.

        Only where objects of the sort share a short name, samples must have the prefix too.
        """
        name = self.names(sort, identity)[0]
        local = self._bridged.local_name(name)
        if local == name:
            return name
        domain = self._stated.instances(sort)
        alike = [each for each in domain if self._bridged.local_name(each) == local]
        return name if len(alike) > 1 else local

    def _names_in(self, sort: str) -> Mapping[str, tuple[str, ...]]:
        if not self._bridged.has_synonyms:
            return {}
        if sort not in self._members:
            members: dict[str, tuple[str, ...]] = defaultdict(tuple)
            for name in self._stated.instances(sort):
                members[self._bridged.identity(name)] += (name,)
            self._members[sort] = dict(members)
        return self._members[sort]
