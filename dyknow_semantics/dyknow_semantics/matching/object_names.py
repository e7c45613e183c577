"""The names of objects in the ontologies that bridges connect.

Example: the ontology `uav` has the object `uav2` of the sort `UAV`, the ontology `robot2` has
`self` of the sort `Drone`, and the bridges say

    robot2:Drone into uav:UAV;
    robot2:self same uav:uav2;

The two names have one identity, here `self` (the least IRI). Requests for `UAV` use the name
`uav2`, and samples of a stream that is annotated `for every d in Drone` use `self`:

    names('UAV', 'self') == ('uav2',)
    key('Drone', 'self') == 'self'
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

from dyknow_semantics.ontology.knowledge import Knowledge


class ObjectNames:
    """The names of objects in the ontology of a sort.

    Args:
        stated: the ontologies without bridges.
        bridged: the same ontologies with bridges.
    """

    def __init__(self, stated: Knowledge, bridged: Knowledge) -> None:
        self._stated = stated
        self._bridged = bridged
        self._identities: dict[str, frozenset[str]] = {}
        self._names: dict[str, Mapping[str, tuple[str, ...]]] = {}

    def identities(self, sort: str) -> frozenset[str]:
        """Return the objects of a sort in its own ontology, without bridges into the sort."""
        if sort not in self._identities:
            objects = self._stated.instances(sort)
            self._identities[sort] = frozenset(map(self._bridged.identity, objects))
        return self._identities[sort]

    def names(self, sort: str, identity: str) -> tuple[str, ...]:
        """Return the names of an object in the ontology of a sort, or its identity if none."""
        if not self._bridged.has_synonyms:
            return (identity,)
        if sort not in self._names:
            names: dict[str, tuple[str, ...]] = defaultdict(tuple)
            for name in self._stated.instances(sort):
                names[self._bridged.identity(name)] += (name,)
            self._names[sort] = dict(names)
        return self._names[sort].get(identity, (identity,))

    def key(self, sort: str, identity: str) -> str:
        """Return the name of an object in samples: its local name in the ontology of the sort.

        Only if objects of the sort share a local name, the name has a prefix.
        """
        name = self.names(sort, identity)[0]
        local = self._bridged.local_name(name)
        if local == name:
            return name
        domain = self._stated.instances(sort)
        alike = [each for each in domain if self._bridged.local_name(each) == local]
        return name if len(alike) > 1 else local
