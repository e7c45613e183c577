"""The annotated fields of streams, found by feature and object without a scan of all."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from itertools import chain
from typing import Any

from dyknow_semantics.annotations.annotation import Annotation, Content
from dyknow_semantics.matching.patterns import Pattern
from dyknow_stream_processing import StreamReference


@dataclass(eq=False, slots=True)
class Offer:
    """One annotated field of a stream.

    Args:
        annotation: of the stream.
        content: of the field.
        pattern: the ground features that the field holds.
        unit: what the values are measured in; empty for none.
        answers: what has been made of it for those who asked.
    """

    annotation: Annotation
    content: Content
    pattern: Pattern
    unit: str
    answers: dict[Any, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        arguments = {argument.name for argument in self.content.feature.arguments}
        ranges = [each for each in self.annotation.ranges if each.variable in arguments]
        every = f' for every {", ".join(map(str, ranges))}' if ranges else ''
        return f'{self.source} carries {self.content.feature}{every}'

    @property
    def source(self) -> StreamReference:
        """The stream as the stream language refers to it."""
        return StreamReference(self.annotation.stream, self.annotation.is_topic)


class OfferIndex:
    """Offers by feature, and by the object at each place of it; `None` stands for a variable."""

    def __init__(self) -> None:
        # Dictionaries are sets that keep their order.
        self._of_feature: dict[str, dict[Offer, None]] = defaultdict(dict)
        self._of_object: dict[tuple[str, int, str | None], dict[Offer, None]] = defaultdict(dict)

    def __iter__(self) -> Iterator[Offer]:
        """Every offer."""
        return chain.from_iterable(self._of_feature.values())

    @property
    def features(self) -> Collection[str]:
        """The features that some offer is of."""
        return self._of_feature.keys()

    def add(self, offer: Offer) -> None:
        """Adds an offer."""
        self._of_feature[offer.pattern.feature][offer] = None
        for key in _keys(offer):
            self._of_object[key][offer] = None

    def remove(self, offer: Offer) -> None:
        """Removes an offer."""
        _discard(self._of_feature, offer.pattern.feature, offer)
        for key in _keys(offer):
            _discard(self._of_object, key, offer)

    def of_feature(self, feature: str) -> Collection[Offer]:
        """The offers of a feature."""
        return self._of_feature.get(feature, {})

    def candidates(self, feature: str, asked: Pattern) -> Collection[Offer]:
        """Offers of a feature, among them all that share an object with a pattern at each place."""
        best = self.of_feature(feature)
        for place, domain in enumerate(asked.domains):
            # Where more objects are possible than there are offers, a scan is the shorter way.
            if len(domain) < len(best):
                found = self._at(feature, place, domain)
                best = found if len(found) < len(best) else best
        return best

    def _at(self, feature: str, place: int, domain: Collection[str]) -> Collection[Offer]:
        found = dict(self._of_object.get((feature, place, None), {}))
        for each in domain:
            found |= self._of_object.get((feature, place, each), {})
        return found


def _keys(offer: Offer) -> Iterator[tuple[str, int, str | None]]:
    for place, (argument, sort) in enumerate(
        zip(offer.pattern.arguments, offer.pattern.sorts, strict=True)
    ):
        yield offer.pattern.feature, place, None if sort else argument


def _discard(offers: dict[Any, dict[Offer, None]], key: object, offer: Offer) -> None:
    of_key = offers[key]
    del of_key[offer]
    if not of_key:
        del offers[key]
