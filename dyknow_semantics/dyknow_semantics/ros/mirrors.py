"""Shared by the semantic nodes: copies of contents, versions that date them, limits of texts."""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final, Generic, TypeVar

from dyknow_interfaces.msg import SemanticsVersion
from dyknow_interfaces.srv import ListSemanticSpecifications, OntologyQuery
from std_msgs.msg import Header

from dyknow_common import read_file
from dyknow_common.ros import LATCHED, LONG_TIMEOUT_S, DyKnowNode, RemoteNode
from dyknow_semantics.annotations.annotation import Annotation
from dyknow_semantics.annotations.parsing import parse_annotations
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.bridges import Bridge, bridged, parse_bridges
from dyknow_semantics.ontology.knowledge import ALL_TRIPLES, Knowledge, Triple

# Texts are parsed in the thread of the node: it takes 1 s for 100,000 words.
TEXT_LIMITS: Final = {
    'max_characters': (20_000, 'Characters of a text in a request.', (100, 1_000_000))
}

Contents = TypeVar('Contents')


class Mirror(Generic[Contents]):
    """A copy of the contents of another node.

    The other node publishes a new version in its status before it answers a request that changes
    its contents.
    """

    def __init__(
        self, remote: RemoteNode, fetch: Callable[[RemoteNode], Awaitable[Contents]]
    ) -> None:
        self.remote = remote
        self._fetch = fetch
        self._status: dict[str, str] = {}
        self._contents: Contents | None = None

    async def contents(self) -> Contents:
        """Return the copy, after an update if it is stale.

        Raises:
            DyKnowError: UNAVAILABLE, if the other node is not running.
        """
        status = dict(self.remote.status)
        if self._contents is None or status != self._status or not self.remote.alive:
            self._contents = await self._fetch(self.remote)
            self._status = status
        return self._contents


def mirror_ontologies(node: DyKnowNode) -> Mirror[Knowledge]:
    """Return a copy of the ontologies, with the bridges between them."""
    name = node.parameter('ontology_manager', 'ontology_manager', 'Name of the ontology manager.')

    async def fetch(remote: RemoteNode) -> Knowledge:
        return bridged(triples_of(await remote.call(OntologyQuery, sparql=ALL_TRIPLES))).known

    return Mirror(RemoteNode(node, name, timeout_s=LONG_TIMEOUT_S), fetch)


@dataclass(frozen=True, slots=True)
class ListedAnnotations:
    """Annotations by canonical text, and the faults of annotations that do not fit streams."""

    annotations: Mapping[str, Annotation]
    faults: Mapping[str, str]


def mirror_annotations(node: DyKnowNode) -> Mirror[ListedAnnotations]:
    """Return a copy of the annotations."""
    name = node.parameter(
        'stream_semantics_manager',
        'stream_semantics_manager',
        'Name of the stream semantics manager.',
    )
    parsed: dict[str, dict[str, Annotation]] = {}

    async def fetch(remote: RemoteNode) -> ListedAnnotations:
        nonlocal parsed
        response = await remote.call(ListSemanticSpecifications)
        # Only new annotations are parsed.
        parsed = {
            text: parsed.get(text) or annotations_by_text([text])
            for text in response.ssl_statements
        }
        annotations = {text: each for found in parsed.values() for text, each in found.items()}
        return ListedAnnotations(annotations, faults_of(response))

    return Mirror(RemoteNode(node, name), fetch)


def annotations_by_text(texts: Iterable[str]) -> dict[str, Annotation]:
    """Return the annotations in SSL texts, by canonical text."""
    return {str(each): each for text in texts for each in parse_annotations(text)}


def faults_of(response: Any) -> dict[str, str]:
    """Return the faults in a response of ListSemanticSpecifications, by canonical text."""
    pairs = zip(response.ssl_statements, response.faults, strict=True)
    return {text: fault for text, fault in pairs if fault}


def triples_of(response: Any) -> Iterable[Triple]:
    """Return the triples in the response to `ALL_TRIPLES`."""
    values = list(response.values)
    return zip(values[0::3], values[1::3], values[2::3], strict=True)


def read_bridges(paths: Iterable[str]) -> tuple[Bridge, ...]:
    """Return the bridges in some files.

    Raises:
        SemanticsError: if a file cannot be read or parsed.
    """
    return tuple(
        bridge
        for path in paths
        for bridge in read_file(Path(path), 'bridges', parse_bridges, SemanticsError)
    )


class VersionPublisher:
    """Counts changes, and publishes each on the latched topic `~/version`."""

    def __init__(self, node: DyKnowNode) -> None:
        self.number = 0
        self._node = node
        self._publisher = node.create_publisher(SemanticsVersion, '~/version', LATCHED)

    def publish_change(self, concepts: Iterable[str] = ()) -> None:
        """Publish the concepts whose matches or instances may have changed; empty: any concept."""
        self.number += 1
        self._publisher.publish(
            SemanticsVersion(
                header=Header(stamp=self._node.get_clock().now().to_msg()),
                version=self.number,
                concepts=list(concepts),
            )
        )
