"""Checks against observed frames: are positions that are calculated with in one frame.

Formulas and streams calculate with coordinates as with any numbers. Those of `positions:` and
regions state their frame, which each sample must have. Here, both are compared with what
`header.frame_id` was in some time.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping

from dyknow_command.linting.findings import Finding, error_at, warning_at
from dyknow_command.linting.inputs import LintInputs
from dyknow_command.linting.vocabulary_checks import annotations_of, streams_of
from dyknow_command.observing import absolute_topic
from dyknow_common import listed
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
from dyknow_space import settings_of
from dyknow_stream_processing import (
    Call,
    Select,
    StreamDeclaration,
    StreamReference,
    subterms,
)
from dyknow_stream_processing import Term as StreamTerm

Topics = frozenset[str]


def frame_findings(inputs: LintInputs, topics: Mapping[str, ObservedTopic]) -> Iterator[Finding]:
    """Yield the formulas and streams that calculate with positions in several frames.

    Args:
        inputs: the files.
        topics: the observed topics with the texts of `FRAME`, by absolute name.
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
        for topic, stated in _stated_frames(declaration):
            if others := {*frames.get(topic, ())} - {stated}:
                yield error_at(
                    place,
                    f'{topic} is in {listed(sorted(others))}, but its frame is stated as {stated}; '
                    'correct it, or let tf transform the positions',
                )


def _stated_frames(declaration: StreamDeclaration) -> Iterator[tuple[str, str]]:
    """Yield the topics whose frame a stream checks, each with the frame that is stated."""
    for call in subterms(declaration.stream):
        for each in call.arguments if isinstance(call, Call) else ():
            text = str(each.value)
            # A frame, or a region with its frame.
            stated = text if each.name == 'frame' else settings_of(text.split(';')).get('frame')
            for topic, select in _selects(call) if stated else ():
                if FRAME in select.demand:
                    yield topic, str(stated)


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
        topic
        for topic, select in _selects(declaration.stream)
        if FRAME not in select.demand  # Whatever reads the frame can check it.
        and any(is_coordinate(selection.field) for selection in select.selections)
    )


def _selects(term: StreamTerm) -> Iterator[tuple[str, Select]]:
    """Yield the topics that a term selects fields of."""
    for each in subterms(term):
        if (
            isinstance(each, Select)
            and isinstance(each.source, StreamReference)
            and each.source.is_topic
        ):
            yield absolute_topic(each.source.name), each
