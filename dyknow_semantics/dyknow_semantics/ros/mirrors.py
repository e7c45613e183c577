"""What the semantic nodes know of each other: copies that are fetched anew when they are stale."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping
from typing import Generic, TypeVar

from dyknow_interfaces.srv import ListSemanticSpecifications, OntologyQuery

from dyknow_common.ros import DyKnowNode, RemoteNode
from dyknow_semantics.annotations.annotation import Annotation
from dyknow_semantics.annotations.parsing import parse_annotations
from dyknow_semantics.matching.bridges import Bridge, Bridged, bridged
from dyknow_semantics.ontology.knowledge import Knowledge, Triple
from dyknow_semantics.ontology.store import ALL_TRIPLES

Content = TypeVar('Content')


class Mirror(Generic[Content]):
    """A copy of what another node holds.

    The other node tells a new version on its status topic before it answers whoever changed it.

    Args:
        peer: the other node.
        fetch: asks it for all that it holds.
    """

    def __init__(self, peer: RemoteNode, fetch: Callable[[RemoteNode], Awaitable[Content]]) -> None:
        self.peer = peer
        self._fetch = fetch
        self._status: dict[str, str] = {}
        self._content: Content | None = None

    async def content(self) -> Content:
        """The copy, fetched anew if it is stale.

        Raises:
            DyKnowError: UNAVAILABLE, when the other node is not there.
        """
        status = dict(self.peer.status)
        if self._content is None or status != self._status or not self.peer.alive:
            self._content = await self._fetch(self.peer)
            self._status = status
        return self._content


def mirror_ontology(node: DyKnowNode) -> Mirror[Knowledge]:
    """The knowledge of the ontology manager that a parameter of the node names."""
    name = node.parameter('ontology_manager', 'ontology_manager', 'Name of the ontology manager.')
    return Mirror(RemoteNode(node, name), _fetch_knowledge)


def mirror_bridged_ontologies(node: DyKnowNode, bridges: tuple[Bridge, ...]) -> Mirror[Bridged]:
    """The same, with what follows over bridges between its ontologies."""
    name = node.parameter('ontology_manager', 'ontology_manager', 'Name of the ontology manager.')

    async def fetch(peer: RemoteNode) -> Bridged:
        return bridged(await _fetch_triples(peer), bridges)

    return Mirror(RemoteNode(node, name), fetch)


def mirror_annotations(node: DyKnowNode) -> Mirror[Mapping[str, Annotation]]:
    """The annotations, by their texts, of the stream semantics manager that a parameter names."""
    name = node.parameter(
        'stream_semantics_manager',
        'stream_semantics_manager',
        'Name of the stream semantics manager.',
    )
    return Mirror(RemoteNode(node, name), _AnnotationReader().fetch)


class _AnnotationReader:
    """Reads annotations; only those that are new are parsed."""

    def __init__(self) -> None:
        self._known: dict[str, dict[str, Annotation]] = {}

    async def fetch(self, peer: RemoteNode) -> Mapping[str, Annotation]:
        """All annotations, by their canonical texts."""
        response = await peer.call(ListSemanticSpecifications)
        known = self._known
        self._known = {text: known.get(text) or _read(text) for text in response.ssl_statements}
        return dict(each for found in self._known.values() for each in found.items())


def _read(text: str) -> dict[str, Annotation]:
    return {str(annotation): annotation for annotation in parse_annotations(text)}


async def _fetch_knowledge(peer: RemoteNode) -> Knowledge:
    return Knowledge(await _fetch_triples(peer))


async def _fetch_triples(peer: RemoteNode) -> Iterable[Triple]:
    response = await peer.call(OntologyQuery, sparql=ALL_TRIPLES)
    values = list(response.values)
    return zip(values[0::3], values[1::3], values[2::3], strict=True)
