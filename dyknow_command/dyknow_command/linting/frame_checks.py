"""Checks against observed frames: are positions that are calculated with in one frame.

Formulas and streams calculate with coordinates as with any numbers. Those of `positions:` and
regions state their frame, and each sample is checked; here, plain fields are compared with what
`header.frame_id` was in some time.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping

from dyknow_command.linting.findings import Finding, warning_at
from dyknow_command.linting.inputs import LintInputs
from dyknow_command.linting.vocabulary_checks import annotations_of, streams_of
from dyknow_command.observing import absolute_topic
from dyknow_configuration import (
    FRAME,
    ObservedTopic,
    frame_difference,
    frames_of,
    is_coordinate,
)
from dyknow_reasoning import (
    Comparison,
    Feature,
    FieldReference,
    Formula,
    Term,
    parse_formula,
    walk,
)
from dyknow_stream_processing import (
    Select,
    StreamDeclaration,
    StreamReference,
    subterms,
)

Topics = frozenset[str]


def frame_findings(inputs: LintInputs, topics: Mapping[str, ObservedTopic]) -> Iterator[Finding]:
    """Yield the formulas and streams that calculate with positions in several frames.

    Args:
        inputs: the files.
        topics: that were observed, with the texts of `FRAME`, by absolute name.
    """
    frames = frames_of(topics.values())

    def difference(used: Topics) -> str:
        found = frame_difference({name: frames[name] for name in used & frames.keys()})
        return f'positions in several frames are calculated with: {found}' if found else ''

    features = _position_features(inputs)
    for formula in inputs.formulas:
        for first, used in _compared(parse_formula(formula.requested.text), features):
            if text := difference(used):
                yield warning_at(formula.place_of(first), text)
    for place, declaration in streams_of(inputs):
        if text := difference(_selected(declaration)):
            yield warning_at(place, f'{declaration.name}: {text}')


def _position_features(inputs: LintInputs) -> Mapping[str, Topics]:
    """Return the topics whose coordinates are features, by the names of the features."""
    found: defaultdict[str, set[str]] = defaultdict(set)
    for _, annotation in annotations_of(inputs):
        for content in annotation.contents:
            if annotation.is_topic and is_coordinate(content.field):
                found[content.feature.name].add(absolute_topic(annotation.stream))
    return {name: frozenset(topics) for name, topics in found.items()}


def _compared(formula: Formula, features: Mapping[str, Topics]) -> Iterator[tuple[str, Topics]]:
    """Yield what each comparison calculates with: its first name, and the topics of positions."""
    for each in walk(formula):
        if isinstance(each, Comparison):
            used = {
                str(term): found for term in walk(each) if (found := _topics_of(term, features))
            }
            if len(used) > 1:
                yield next(iter(used)).partition('[')[0], frozenset().union(*used.values())


def _topics_of(term: Formula | Term, features: Mapping[str, Topics]) -> Topics:
    if isinstance(term, Feature):
        return features.get(term.name, frozenset())
    if isinstance(term, FieldReference) and is_coordinate(term.path):
        return frozenset({absolute_topic(term.stream)})
    return frozenset()


def _selected(declaration: StreamDeclaration) -> Topics:
    """Return the topics whose coordinates a stream is made of, without their frames."""
    return frozenset(
        absolute_topic(each.source.name)
        for each in subterms(declaration.stream)
        if isinstance(each, Select)
        and isinstance(each.source, StreamReference)
        and each.source.is_topic
        and FRAME not in each.demand  # Whatever reads the frame can check it.
        and any(is_coordinate(selection.field) for selection in each.selections)
    )
