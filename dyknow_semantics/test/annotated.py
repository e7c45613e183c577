"""Matchers of annotations, for tests."""

from collections.abc import Iterable

from dyknow_semantics import Annotation, Knowledge, Matcher


def matcher_of(annotations: Iterable[Annotation], knowledge: Knowledge) -> Matcher:
    matcher = Matcher(knowledge)
    matcher.set_annotations({str(each): each for each in annotations})
    return matcher
