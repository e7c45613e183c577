"""What peers share, in the ontology and the annotations of this host.

Each change of a peer is a change here: objects, features and annotations are added and removed, as
any client may do. The objects of peers belong to the sort `RemoteObject`: by this sort, a restarted
node finds the objects that its earlier run has left.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from itertools import chain
from typing import Any, Final

from dyknow_interfaces.srv import (
    AddSemanticSpecification,
    ConceptCreate,
    InstanceCreate,
    InstanceDestroy,
    RemoveSemanticSpecification,
)

from dyknow_common import DyKnowError, ExitCode
from dyknow_common.ros import DyKnowNode
from dyknow_federation.errors import FederationError
from dyknow_federation.meaning import ImportedStream, Imports, imports, missing_features
from dyknow_federation.messages import Shares
from dyknow_federation.offers import ANY_SORT, REMOTE, Offer, offers
from dyknow_semantics import Knowledge, Matcher, parse_concept
from dyknow_semantics.ros.mirrors import mirror_annotations, mirror_ontologies

MAX_MATCHES: Final = 10_000

_OF_ANNOTATIONS: Final = {AddSemanticSpecification, RemoveSemanticSpecification}


class SharedVocabulary:
    """The ontology and the annotations of this host, and what peers add to them.

    Args:
        node: the node.
        same: the objects whose name means the same everywhere.
        topic: returns the topic of a stream, given the names of its peer and of the stream.
        prefix: the beginning of these topics.
    """

    def __init__(
        self,
        node: DyKnowNode,
        same: tuple[str, ...],
        topic: Callable[[str, str], str],
        prefix: str,
    ) -> None:
        self.faults: tuple[str, ...] = ()
        """What cannot be used from peers, and why."""
        self._sorts: Mapping[str, tuple[str, ...]] = {}
        """The sorts of the objects of peers, as peers told them last."""
        self._same = same
        self._topic = topic
        self._prefix = prefix
        self._ontologies = mirror_ontologies(node)
        self._annotations = mirror_annotations(node)
        self._matcher = Matcher(Knowledge(()))

    @property
    def version(self) -> object:
        """The statuses of the nodes that hold both, which change with both; None without a node."""
        remotes = self._ontologies.remote, self._annotations.remote
        is_known = all(each.alive for each in remotes)
        return [dict(each.status) for each in remotes] if is_known else None

    async def offers(self, features: Collection[str]) -> tuple[list[Offer], Knowledge, list[str]]:
        """Return an offer for each ground feature of some features, and what cannot be shared."""
        knowledge = await self._ontologies.contents()
        listed = await self._annotations.contents()
        self._matcher.set_knowledge(knowledge)
        self._matcher.set_annotations(listed.annotations, listed.faults)
        found: list[Offer] = []
        faults: list[str] = []
        for name in features:
            try:
                matches = self._matcher.match(parse_concept(name), MAX_MATCHES)
                texts = [each.specification for each in matches]
                of_feature = list(offers(knowledge.feature(name), texts, self._prefix))
                if not of_feature:
                    raise FederationError('no stream of this host carries it')
                found += of_feature
            except DyKnowError as error:
                faults.append(f"the feature '{name}' cannot be shared: {error}")
        return found, knowledge, faults

    async def apply(self, shares: Mapping[str, Shares]) -> Imports:
        """Make the ontology and the annotations say what peers share now.

        Raises:
            DyKnowError: if a node does not answer; a later call continues.
        """
        knowledge = (await self._ontologies.contents()).stated
        remote = set(knowledge.instances(REMOTE)) if REMOTE in knowledge.sorts else set()
        own = {name for sort in knowledge.sorts for name in knowledge.instances(sort)} - remote
        due = imports(shares, own, self._same, self._topic, remote)
        faults = list(due.faults)
        annotations = (await self._annotations.contents()).annotations.items()
        topics = {each.stream: text for text, each in annotations if each.is_topic}
        present = {each: text for each, text in topics.items() if each.startswith(self._prefix)}
        wanted = {self._topic(*name): each.annotation for name, each in due.streams.items()}
        for topic, text in present.items():
            if wanted.get(topic) != text:
                await self._try(faults, RemoveSemanticSpecification, stream_name=topic)
        for name in list(remote):
            sorts = {*due.objects.get(name, [''])}
            if not {*self._sorts.get(name, ())} <= sorts <= {*knowledge.concepts(name)}:
                await self._try(faults, InstanceDestroy, instance_name=name)
                remote.remove(name)
        added = {name: each for name, each in due.objects.items() if name not in remote}
        texts = set(present.values())
        streams = [each for each in due.streams.values() if each.annotation not in texts]
        await self._add(knowledge, added, streams, faults)
        self.faults, self._sorts = tuple(faults), due.objects
        return due

    async def _add(
        self,
        knowledge: Knowledge,
        objects: Mapping[str, tuple[str, ...]],
        streams: list[ImportedStream],
        faults: list[str],
    ) -> None:
        sorts_of = {name: [*each, REMOTE] for name, each in objects.items()}
        for sort in sorted({*chain.from_iterable(sorts_of.values())} - {*knowledge.sorts}):
            await self._try(faults, ConceptCreate, concept_name=sort, parent_concepts=[ANY_SORT])
        for name, sorts in sorts_of.items():
            await self._try(faults, InstanceCreate, instance_name=name, concept_names=sorts)
        features = [each.name for each in knowledge.features]
        for feature, arguments in missing_features(streams, features):
            await self._try(
                faults,
                ConceptCreate,
                concept_name=feature.name,
                parent_concepts=[] if arguments else ['NullaryFeature'],
                argument_sorts=arguments,
                value_type=feature.value_type,
                unit=feature.unit,
            )
        for each in streams:
            await self._try(faults, AddSemanticSpecification, ssl_statement=each.annotation)

    async def _try(self, faults: list[str], service_type: Any, **fields: Any) -> None:
        """Make a change that the contents of the peers may forbid."""
        holder = self._annotations if service_type in _OF_ANNOTATIONS else self._ontologies
        try:
            await holder.remote.call(service_type, **fields)
        except DyKnowError as error:
            if error.code is ExitCode.UNAVAILABLE:
                raise
            if error.code is not ExitCode.ALREADY_EXISTS:
                faults.append(f'{next(iter(fields.values()))}: {error}')
