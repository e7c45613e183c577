"""The names of objects in the ontologies that bridges connect.

Example: the ontology `uav` has the object `uav2` of the sort `UAV`, the ontology `robot2` has
`self` of the sort `Drone`, and the bridges say

    robot2:Drone into uav:UAV;
    robot2:self same uav:uav2;

The two names have one identity, here `self` (the least IRI). Requests for `UAV` use the name
`uav2`, and samples of a stream that is annotated `for every d in Drone` use `self`:

    name('UAV', 'self') == 'uav2'
    key('Drone', 'self') == 'self'
"""

from __future__ import annotations

from collections.abc import Mapping

from dyknow_semantics.ontology.knowledge import Knowledge


class ObjectNames:
    """The names of objects as instances of a sort.

    Args:
        knowledge: of the ontologies with bridges.
    """

    def __init__(self, knowledge: Knowledge) -> None:
        self._knowledge = knowledge
        self._identities: dict[str, frozenset[str]] = {}
        self._names: dict[str, Mapping[str, str]] = {}

    def identities(self, sort: str) -> frozenset[str]:
        """Return the objects of a sort in its own ontology, without bridges into the sort."""
        if sort not in self._identities:
            objects = self._knowledge.stated.instances(sort)
            self._identities[sort] = frozenset(map(self._knowledge.identity, objects))
        return self._identities[sort]

    def name(self, sort: str, identity: str) -> str:
        """Return the name that an object of a sort has in `Knowledge.instances`."""
        if not self._knowledge.has_synonyms:
            return identity
        if sort not in self._names:
            names = self._knowledge.instances(sort)
            self._names[sort] = {self._knowledge.identity(each): each for each in names}
        return self._names[sort][identity]

    def key(self, sort: str, identity: str) -> str:
        """Return the name of an object in samples: its local name in the ontology of the sort.

        Only if objects of the sort share a local name, the name has a prefix.
        """
        name = self.name(sort, identity)
        local = self._knowledge.local_name(name)
        if local == name:
            return name
        domain = self._knowledge.stated.instances(sort)
        alike = [each for each in domain if self._knowledge.local_name(each) == local]
        return name if len(alike) > 1 else local
