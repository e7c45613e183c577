"""The words of peers in the ontology of this host."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

from dyknow_federation.messages import SharedObject, Shares
from dyknow_federation.offers import ANY_SORT, REMOTE
from dyknow_federation.ros.vocabulary import SharedVocabulary


class Ontology:
    """Holds objects by their sorts, as the ontology manager does."""

    def __init__(self, monkeypatch: Any) -> None:
        self.objects: dict[str, set[str]] = {}
        self.changes: list[tuple[str, str]] = []
        name = 'dyknow_federation.ros.vocabulary.mirror_'
        annotations = SimpleNamespace(annotations={})
        for kind, contents in (('ontologies', self.contents), ('annotations', lambda: annotations)):
            mirror = SimpleNamespace(contents=awaited(contents), remote=self)
            monkeypatch.setattr(name + kind, lambda _, mirror=mirror: mirror)

    def contents(self) -> Any:
        knowledge = SimpleNamespace(
            sorts=['Robot', 'Arm', ANY_SORT, REMOTE],
            features=[],
            instances=lambda sort: [name for name, each in self.objects.items() if sort in each],
            concepts=lambda name: [*self.objects[name], ANY_SORT],
        )
        return SimpleNamespace(stated=knowledge)

    async def call(self, kind: Any, instance_name: str, concept_names: Any = ()) -> None:
        self.changes.append((kind.__name__, instance_name))
        if kind.__name__ == 'InstanceDestroy':
            del self.objects[instance_name]
        else:
            self.objects[instance_name] = {*concept_names}


def awaited(work: Any) -> Any:
    async def found() -> Any:
        return work()

    return found


def test_objects_have_the_sorts_that_peers_say_now(monkeypatch: Any) -> None:
    """A sort that a peer takes back has the object no more: formulas are about all of a sort."""
    ontology = Ontology(monkeypatch)
    words = SharedVocabulary(object(), (), lambda *names: '/'.join(names), '/')  # type: ignore[arg-type]

    def tell(*sorts: str) -> list[str]:
        ontology.changes.clear()
        objects = (SharedObject('r1', sorts),) if sorts else ()
        asyncio.run(words.apply({'p': Shares(1, objects)}))
        assert ontology.objects == ({'r1': {*sorts, REMOTE}} if sorts else {})
        return [kind for kind, _ in ontology.changes]

    assert tell('Robot', 'Arm') == ['InstanceCreate']
    assert tell('Robot', 'Arm') == []
    assert tell('Robot') == ['InstanceDestroy', 'InstanceCreate']
    assert tell('Robot') == []
    assert tell('Arm', 'Robot') == ['InstanceDestroy', 'InstanceCreate']
    ontology.objects['r1'].add('Painted')
    asyncio.run(words.apply({'p': Shares(1, (SharedObject('r1', ('Arm', 'Robot')),))}))
    assert 'Painted' in ontology.objects['r1'], 'a user may say more of it'
    ontology.objects['r1'].discard('Painted')
    assert tell() == ['InstanceDestroy']
