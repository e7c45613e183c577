"""The streams that this host offers to its peers: one for each ground feature that it shares.

Semantic matching finds the streams, as it does for formulas. For the shared feature `Charge`,

    stream s = select percentage as "Charge[carrier1]" from "/carrier1/battery" with max_gap = 1 s;

becomes the offer `Charge_carrier1` with the field `value`. A stream that came from a peer is never
offered again: each peer speaks for itself.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import Final

from dyknow_common import unused_name
from dyknow_federation.messages import SharedFeature, SharedObject, Shares
from dyknow_semantics import FeatureSignature, FeatureTerm, Knowledge, parse_concept
from dyknow_stream_processing import (
    Select,
    Specification,
    StreamDeclaration,
    parse_specification,
    references,
)

ANY_SORT: Final = 'Object'
"""The sort of all objects, in the upper ontology."""

REMOTE: Final = 'RemoteObject'
"""The sort of the objects that only peers know."""

VALUE: Final = 'value'
"""The field of an offered stream that holds the feature."""


@dataclass(frozen=True, slots=True)
class Offer:
    """A stream that peers may ask for.

    Args:
        feature: that it carries.
        ground: the feature with its objects.
        specification: how it is made here.
    """

    feature: FeatureSignature
    ground: FeatureTerm
    specification: str


def offers(feature: FeatureSignature, texts: Iterable[str], imported: str) -> Iterator[Offer]:
    """Yield an offer for each ground feature that streams carry; of several, the first one.

    Args:
        feature: that is shared.
        texts: specifications of streams that carry it, each with a ground feature as its field, the
            best first.
        imported: the beginning of the topics of peers' streams.
    """
    seen: set[str] = set()
    for text in texts:
        parsed = parse_specification(text)
        (declaration,) = parsed.declared(StreamDeclaration)
        stream = declaration.stream
        if not isinstance(stream, Select):
            continue
        ground = stream.selections[0].name
        if ground in seen or any(each.name.startswith(imported) for each in references(stream)):
            continue
        seen.add(ground)
        selection = replace(stream.selections[0], renaming=VALUE)
        renamed = replace(declaration, stream=replace(stream, selections=(selection,)))
        others = (each for each in parsed.declarations if each is not declaration)
        specification = str(Specification((*others, renamed)))
        yield Offer(feature, parse_concept(ground).feature, specification)


def shares(
    version: int,
    offered: Iterable[Offer],
    knowledge: Knowledge,
    deadbands: Mapping[str, float | None],
) -> tuple[Shares, dict[str, Offer]]:
    """Return what peers are told, and the offers by the names of their streams.

    Args:
        version: the version of the shares.
        offered: all offers.
        knowledge: knows the sorts of the objects.
        deadbands: the deadband of each shared feature; None: all samples are sent.
    """
    by_name: dict[str, Offer] = {}
    features: list[SharedFeature] = []
    for each in offered:
        text = re.sub('[^A-Za-z0-9]+', '_', str(each.ground)).strip('_')
        name = unused_name(text, by_name)
        by_name[name], feature = each, each.feature
        objects = tuple(argument.name for argument in each.ground.arguments)
        deadband, value_type = deadbands[feature.name] or 0, feature.value_type.value
        features.append(
            SharedFeature(feature.name, objects, name, value_type, feature.unit or '', deadband)
        )
    names = sorted({name for each in features for name in each.objects})
    shared = tuple(SharedObject(name, _sorts(name, knowledge)) for name in names)
    return Shares(version, shared, tuple(features)), by_name


def _sorts(name: str, knowledge: Knowledge) -> tuple[str, ...]:
    """Return the sorts of an object, specific sorts first, without the ones that all peers know."""
    found = (each for each in knowledge.concepts(name) if each not in {ANY_SORT, REMOTE})
    return tuple(found) or (ANY_SORT,)
