"""Checks against observed frames: are positions that are calculated with in one frame.

Formulas and streams calculate with coordinates as with any numbers. Those of `positions:` and
regions state their frame, and each sample is checked; here, plain fields are compared with what
`header.frame_id` was in some time.
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping
from typing import Final

from dyknow_command.linting.findings import Finding, warning_at
from dyknow_command.linting.inputs import LintInputs
from dyknow_command.linting.vocabulary_checks import annotations_of, streams_of
from dyknow_command.observing import absolute_topic
from dyknow_common import listed
from dyknow_configuration import ObservedTopic
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

FRAME: Final = 'header.frame_id'
"""The field that names the frame of a message."""

_COORDINATE: Final = re.compile(r'(?:.*\.)?(?:position|translation|point)\.[xyz]')

Topics = frozenset[str]


def frame_findings(inputs: LintInputs, topics: Mapping[str, ObservedTopic]) -> Iterator[Finding]:
    """Yield the formulas and streams that calculate with positions in several frames.

    Args:
        inputs: the files.
        topics: that were observed, with the texts of `FRAME`, by absolute name.
    """
    frames = {
        name: frozenset(each.values[FRAME].texts)
        for name, each in topics.items()
        if FRAME in each.values
    }
    features = _position_features(inputs)
    for formula in inputs.formulas:
        for first, used in _compared(parse_formula(formula.requested.text), features):
            if text := _difference(used, frames):
                yield warning_at(formula.place_of(first), text)
    for place, declaration in streams_of(inputs):
        if text := _difference(_selected(declaration), frames):
            yield warning_at(place, f'{declaration.name}: {text}')


def _position_features(inputs: LintInputs) -> Mapping[str, Topics]:
    """Return the topics whose coordinates are features, by the names of the features."""
    found: defaultdict[str, set[str]] = defaultdict(set)
    for _, annotation in annotations_of(inputs):
        for content in annotation.contents:
            if annotation.is_topic and _COORDINATE.fullmatch(content.field):
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
    if isinstance(term, FieldReference) and _COORDINATE.fullmatch(term.path):
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
        and any(_COORDINATE.fullmatch(selection.field) for selection in each.selections)
    )


def _difference(used: Iterable[str], frames: Mapping[str, Iterable[str]]) -> str:
    """Return how the frames of topics differ; empty if they do not, as far as they are known."""
    known = {name: sorted(frames.get(name, ())) for name in sorted(used)}
    _, *others = {frame for found in known.values() for frame in found} or {''}
    if not others:
        return ''
    named = [f'{name} is in {listed(found)}' for name, found in known.items() if found]
    return (
        f'positions in several frames are calculated with: {"; ".join(named)}; let tf transform '
        'them, or publish them in one frame'
    )
