"""The meaning of what peers share, in the words of this host.

A peer says what it knows, and which of its streams carry which features of it:

    carrier1: the object carrier1 of the sort Robot
              the stream Charge_carrier1 with Charge[carrier1]

Here, that stream is a topic, and the object is like any other. A name that another peer or this
host uses, too, may mean something else there. So the names of peers are qualified by the name of
the peer, unless the object is declared to be the same:

    stream "/dyknow/federation/carrier1/Charge_carrier1" contains Charge[carrier1] = value;
    stream "/dyknow/federation/carrier2/Charge_part"     contains Charge[carrier2_part] = value;
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from dyknow_common import DyKnowError, shortened
from dyknow_federation.errors import FederationError
from dyknow_federation.messages import SharedFeature, SharedObject, Shares
from dyknow_federation.offers import ANY_SORT, VALUE
from dyknow_semantics import Annotation, Content, FeatureArgument, FeatureTerm, parse_annotations

MAX_STREAMS: Final = 2_000
"""The number of streams of a peer that are known here."""

MAX_ANNOTATION: Final = 1_000
"""The length of the annotation of a stream."""

_NAME: Final = re.compile('[A-Za-z_][A-Za-z0-9_]{0,99}')
_OBJECT: Final = re.compile('[A-Za-z_][A-Za-z0-9_.-]{0,199}')


@dataclass(frozen=True, slots=True)
class ImportedStream:
    """A stream of a peer, with its contents in SSL, which names the topic here."""

    annotation: str
    feature: SharedFeature
    sorts: tuple[str, ...]
    """The sorts of the arguments of the feature, as far as its objects tell."""


@dataclass(frozen=True, slots=True)
class Imports:
    """All that peers share, in the words of this host.

    Args:
        objects: the sorts of each object that is not known here otherwise.
        streams: the streams, by the names of peer and stream.
        faults: what cannot be used, and why.
    """

    objects: Mapping[str, tuple[str, ...]]
    streams: Mapping[tuple[str, str], ImportedStream]
    faults: tuple[str, ...] = ()


def imports(
    shares: Mapping[str, Shares],
    own: Collection[str],
    same: Collection[str],
    topic: Callable[[str, str], str],
    former: Collection[str] = (),
) -> Imports:
    """Return the meaning of what peers share.

    Args:
        shares: by the names of the peers.
        own: the objects that this host knows without its peers.
        same: the objects whose name means the same everywhere.
        topic: returns the topic of a stream, given the names of its peer and of the stream.
        former: the objects of peers so far; qualified names stay qualified, as formulas use them.
    """
    uses = Counter(each.name for given in shares.values() for each in given.objects)
    several = {name for name, number in uses.items() if number > 1 or name in own} - {*same}
    kept = {*former} - uses.keys() - {f'{peer}_{name}' for peer in shares for name in same}
    objects: dict[str, tuple[str, ...]] = {}
    streams: dict[tuple[str, str], ImportedStream] = {}
    faults: list[str] = []
    for peer, given in sorted(shares.items()):
        known = {each.name: each for each in given.objects if _is_usable(each, peer, faults)}
        names = {name: f'{peer}_{name}' for name in known}
        names |= {each: each for each in known if each not in several and names[each] not in kept}
        for name, local in names.items():
            if local != name and local in {*own, *uses, *objects}:
                faults.append(f"peer '{peer}' shares '{name}', but '{local}' exists, too")
                del known[name]
            elif local not in own:
                objects[local] = tuple(dict.fromkeys((*objects.get(local, ()), *known[name].sorts)))
        for feature in given.features[:MAX_STREAMS]:
            try:
                streams[peer, feature.stream] = _imported(peer, feature, known, names, topic)
            except DyKnowError as error:
                faults.append(f"peer '{peer}', stream '{shortened(feature.stream)}': {error}")
        if len(given.features) > MAX_STREAMS:
            faults.append(f"peer '{peer}' shares more than {MAX_STREAMS:,} streams; share fewer")
    return Imports(objects, streams, tuple(faults))


def _is_usable(shared: SharedObject, peer: str, faults: list[str]) -> bool:
    """Return False for an object that cannot be named here, and say so."""
    names = (shared.name, *shared.sorts)
    wrong = next((each for each in names if not _OBJECT.fullmatch(each)), None)
    if wrong is not None:
        faults.append(f"peer '{peer}' shares '{shortened(wrong)}', which cannot be a name here")
    elif not shared.sorts:
        faults.append(f"peer '{peer}' shares '{shared.name}' without a sort")
    return wrong is None and bool(shared.sorts)


def _imported(
    peer: str,
    feature: SharedFeature,
    known: Mapping[str, SharedObject],
    names: Mapping[str, str],
    topic: Callable[[str, str], str],
) -> ImportedStream:
    if not (_NAME.fullmatch(feature.stream) and _NAME.fullmatch(feature.name)):
        raise FederationError('it cannot be a name here; use letters, digits and _')
    if unknown := [each for each in feature.objects if each not in known]:
        raise FederationError(f"the object '{shortened(unknown[0])}' is not shared")
    arguments = tuple(FeatureArgument(names[each]) for each in feature.objects)
    term = FeatureTerm(feature.name, arguments)
    # Without constraints: watermarks say how far the samples are known, and its host tells more.
    contents = (Content(term, VALUE, feature.unit or None),)
    annotation = Annotation(topic(peer, feature.stream), contents, is_topic=True)
    if _parsed(str(annotation)) != (annotation,):  # Whatever the peer says may be in it.
        raise FederationError(f"'{shortened(feature.unit)}' is no unit")
    sorts = tuple(known[each].sorts[0] for each in feature.objects)  # The most specific one.
    return ImportedStream(str(annotation), feature, sorts)


@lru_cache(maxsize=2 * MAX_STREAMS)
def _parsed(text: str) -> tuple[Annotation, ...]:
    """Parse an annotation, once for all changes of other streams."""
    if len(text) > MAX_ANNOTATION:
        raise FederationError(f'its annotation has more than {MAX_ANNOTATION:,} characters')
    return parse_annotations(text)


def missing_features(
    streams: Collection[ImportedStream], known: Collection[str]
) -> Iterator[tuple[SharedFeature, list[str]]]:
    """Yield each feature that this host does not know, with the sorts of its arguments."""
    carried: dict[str, list[ImportedStream]] = {}
    for each in streams:
        if each.feature.name not in known:
            carried.setdefault(each.feature.name, []).append(each)
    for found in carried.values():
        sorts = [set(each) for each in zip(*(each.sorts for each in found), strict=False)]
        yield found[0].feature, [each.pop() if len(each) == 1 else ANY_SORT for each in sorts]
