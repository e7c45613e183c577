"""An index of annotated fields by feature and object."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator
from itertools import chain
from typing import Any

from dyknow_semantics.matching.patterns import Pattern
from dyknow_semantics.matching.specifications import AnnotatedField


class FieldIndex:
    """Annotated fields by feature, and by feature, argument index and object.

    `None` instead of an object stands for a variable.
    """

    def __init__(self) -> None:
        # The dictionaries are used as ordered sets.
        self._of_feature: dict[str, dict[AnnotatedField, None]] = defaultdict(dict)
        self._of_object: dict[tuple[str, int, str | None], dict[AnnotatedField, None]] = (
            defaultdict(dict)
        )

    def __iter__(self) -> Iterator[AnnotatedField]:
        """Iterate over all fields."""
        return chain.from_iterable(self._of_feature.values())

    @property
    def features(self) -> Collection[str]:
        """The features that at least one field carries."""
        return self._of_feature.keys()

    def add(self, carrier: AnnotatedField) -> None:
        """Add a field."""
        self._of_feature[carrier.pattern.feature][carrier] = None
        for key in _keys(carrier):
            self._of_object[key][carrier] = None

    def remove(self, carrier: AnnotatedField) -> None:
        """Remove a field."""
        _discard(self._of_feature, carrier.pattern.feature, carrier)
        for key in _keys(carrier):
            _discard(self._of_object, key, carrier)

    def of_feature(self, feature: str) -> Collection[AnnotatedField]:
        """Return the fields that carry a feature."""
        return self._of_feature.get(feature, {})

    def candidates(self, feature: str, requested: Pattern) -> Collection[AnnotatedField]:
        """Return the fields of a feature that may match a pattern, and perhaps others."""
        best = self.of_feature(feature)
        for index, domain in enumerate(requested.domains):
            # If there are more objects than fields, a scan of the fields is faster.
            if len(domain) < len(best):
                found = dict(self._of_object.get((feature, index, None), {}))
                for each in domain:
                    found |= self._of_object.get((feature, index, each), {})
                best = found if len(found) < len(best) else best
        return best


def _keys(carrier: AnnotatedField) -> Iterator[tuple[str, int, str | None]]:
    pattern = carrier.pattern
    for index, (argument, sort) in enumerate(zip(pattern.arguments, pattern.sorts, strict=True)):
        yield pattern.feature, index, None if sort else argument


def _discard(
    index: dict[Any, dict[AnnotatedField, None]], key: object, carrier: AnnotatedField
) -> None:
    carriers = index[key]
    del carriers[carrier]
    if not carriers:
        del index[key]
