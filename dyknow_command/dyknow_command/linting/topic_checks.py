"""Checks against observed topics: are they published, once, with messages, and in time."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Final

from dyknow_command.linting.findings import FilePlace, Finding, error_at, warning_at
from dyknow_command.linting.inputs import LintInputs, PlacedFormula
from dyknow_command.linting.vocabulary_checks import (
    annotations_of,
    references_of,
    sources_of,
    streams_of,
)
from dyknow_command.observing import absolute_topic
from dyknow_common import (
    NO_CONSTRAINTS,
    ComputedField,
    DyKnowError,
    ElementKey,
    InlineText,
    MessagePath,
    StreamConstraints,
    parse_field,
)
from dyknow_configuration import (
    ObservedTopic,
    broken_constraints,
)
from dyknow_recordings import TopicContent
from dyknow_stream_processing import (
    BuiltInSource,
    Select,
    StreamReference,
    Term,
    nearest_topics,
    read_streams,
    references,
    subterms,
)

_PLAIN: Final = re.compile(r'[\w.]+(?:\[-?\d+\][\w.]*)*')
"""A path without conditions and functions, for which later messages may have elements."""

_STAMP: Final = re.compile(r'\bstamp\.(?:nano)?sec$')
"""The end of the path of a stamp."""

_QUOTED_STREAM: Final = re.compile(r'"([A-Za-z_]\w*)"(?=\.)')
_OF_ROS: Final = re.compile(r'(/~)?(/[A-Za-z_{][A-Za-z0-9_{}]*)+')
"""The absolute names that topics of ROS may have; nodes know what ~ and {node} stand for."""

_OF_ALL_NODES: Final = frozenset({'/parameter_events', '/rosout'})
"""Topics on which each node publishes, and only what happens."""


@dataclass(frozen=True, slots=True)
class TopicUse:
    """A topic that a file names.

    Args:
        topic: its absolute name.
        place: where it is named.
        constraints: the constraints that it must keep.
        is_shared: True if several publishers are expected.
        is_element: True if elements of the messages are read, by a key: several publishers may each
            send some of the elements, at times of their own.
    """

    topic: str
    place: FilePlace
    constraints: StreamConstraints = NO_CONSTRAINTS
    is_shared: bool = False
    is_element: bool = False


def contents_of(topics: Mapping[str, ObservedTopic]) -> Mapping[str, TopicContent]:
    """Return what the messages of observed topics hold."""
    return {
        name: TopicContent(each.message_type, each.fields, each.times.is_stamped, each.count)
        for name, each in topics.items()
    }


def name_findings(inputs: LintInputs, topics: Mapping[str, ObservedTopic]) -> Iterator[Finding]:
    """Yield topics whose names ROS does not allow; recordings of other systems may contain them."""
    for use in topic_uses(inputs):
        if use.topic not in topics and not _OF_ROS.fullmatch(use.topic):
            text = (
                f"ROS cannot have a topic '{use.topic}': between slashes, use letters, digits and "
                '_, and begin with no digit'
            )
            yield error_at(use.place, text)


def stream_name_findings(inputs: LintInputs) -> Iterator[Finding]:
    """Yield the streams of formulas that are not known, as some may mean topics."""
    known = {each.input for each in inputs.guards}
    known |= {each.name for _, each in streams_of(inputs)}
    known |= {each.stream for _, each in annotations_of(inputs) if not each.is_topic}
    with suppress(DyKnowError):  # Reported elsewhere.
        known |= {each.name for each in read_streams(inputs.files.streams)}
    # Without these, the streams may be defined in other files.
    is_whole = (inputs.has_robot or inputs.files.streams) and not inputs.has_peers
    for formula in inputs.formulas:
        if is_whole:
            yield from _unknown_streams(formula, known)
        for found in _QUOTED_STREAM.finditer(formula.requested.text):
            if found[1] not in known:
                text = (
                    f'{found[0]} is the stream {found[1]}, as it has no slash; for the topic, '
                    f'write its absolute name, or make a stream or a feature of {found[0]}; '
                    'streams need no quotes'
                )
                yield warning_at(formula.place(found.start()), text)


def _unknown_streams(formula: PlacedFormula, known: set[str]) -> Iterator[Finding]:
    """Yield the names without quotes that a formula has for streams that are not known."""
    named = {
        each.name
        for source, _ in sources_of(formula)
        for each in references(source)
        if not each.is_topic and each.name not in known
    }
    for name in sorted(named):
        near = get_close_matches(name, known, n=1)
        mend = 'define it, or for a topic write its absolute name in quotes'
        if near:
            mend = f"did you mean '{near[0]}'?"
        text = f"no stream '{name}' is known; {mend}"
        for found in re.finditer(rf'(?<![\w."/]){re.escape(name)}(?=\.)', formula.requested.text):
            yield warning_at(formula.place(found.start()), text)


def topic_findings(
    inputs: LintInputs, topics: Mapping[str, ObservedTopic], where: str
) -> Iterator[Finding]:
    """Yield the topics that are missing, silent, or do not keep their constraints.

    Args:
        inputs: the files.
        topics: the observed topics, by absolute name.
        where: they were observed, such as `in flight.mcap`.
    """
    for use in topic_uses(inputs):
        topic = topics.get(use.topic)
        if topic is None or topic.publishers == 0:
            near = nearest_topics(use.topic, list(topics))[:2]
            hint = (
                f'did you mean {" or ".join(near)}?' if near else 'check its name and its publisher'
            )
            yield error_at(use.place, f'there is no topic {use.topic} {where}; {hint}')
        elif topic.fields is None:
            text = f'{use.topic}: its message type {topic.message_type} is not defined'
            yield error_at(use.place, f'{text}; install its package, or record its definition')
        elif not topic.count and use.topic not in _OF_ALL_NODES:
            text = f'no message of {use.topic} came {where}; its timing was not checked'
            yield warning_at(use.place, text)
        else:
            yield from _observed_findings(use, topic)
    for name, field, place in _named_fields(inputs):
        if name in topics and (reason := topics[name].absent.get(field)):
            finding = error_at if _PLAIN.fullmatch(field) else warning_at
            yield finding(place, f'no message of {name} has {field}: {reason}')


def named_fields(inputs: LintInputs) -> set[str]:
    """Return the fields of topics that formulas and annotations name."""
    return {field for _, field, _ in _named_fields(inputs)}


def _named_fields(inputs: LintInputs) -> Iterator[tuple[str, str, FilePlace]]:
    """Yield the topics that files read, with the fields and their places."""
    for formula in inputs.formulas:
        for name, field in references_of(formula):
            yield name, field, formula.place_of(field)
    for source, annotation in annotations_of(inputs):
        # The fields of elements are relative to these.
        if annotation.is_topic and annotation.elements is None:
            for content in annotation.contents:
                yield absolute_topic(annotation.stream), content.field, inputs.place_of(source)


def _observed_findings(use: TopicUse, topic: ObservedTopic) -> Iterator[Finding]:
    if (topic.publishers or 0) > 1 and (use.is_element or use.topic in _OF_ALL_NODES):
        return
    if (topic.publishers or 0) > 1 and not use.is_shared:
        text = (
            f'{use.topic} has {topic.publishers} publishers, whose samples are mixed; stop all but '
            'one, or give them topics of their own'
        )
        yield warning_at(use.place, text)
    for text in broken_constraints(topic.times, use.constraints):
        yield error_at(use.place, f'{use.topic}: {text}')


def topic_uses(inputs: LintInputs) -> Iterator[TopicUse]:
    """Yield the topics that files name: in annotations, streams, expectations and formulas."""
    for source, annotation in annotations_of(inputs):
        if annotation.is_topic:
            place = inputs.place_of(source)
            is_shared = bool(annotation.keys) or annotation.elements is not None
            # On a topic of many objects, the timing concerns one object, not the topic.
            stated = NO_CONSTRAINTS if is_shared else annotation.constraints
            is_element = any(_has_key(each.field) for each in annotation.contents)
            topic = absolute_topic(annotation.stream)
            yield TopicUse(topic, place, stated, is_shared, is_element)
    yield from _stream_uses(inputs)
    yield from _expected_uses(inputs)
    for formula in inputs.formulas:
        for named, field in sources_of(formula):
            for each in references(named):
                if each.is_topic:
                    place, topic = formula.place_of(each.name), absolute_topic(each.name)
                    is_shared = isinstance(named, BuiltInSource)
                    is_element = _has_key(field)
                    yield TopicUse(topic, place, is_shared=is_shared, is_element=is_element)
        if formula.requested.record is not None:
            for topic in formula.requested.record.topics:
                yield TopicUse(absolute_topic(topic), formula.place(0), is_shared=True)


def _expected_uses(inputs: LintInputs) -> Iterator[TopicUse]:
    for each in inputs.expectations:
        place = inputs.place_of(InlineText(each.place, ''))
        yield TopicUse(each.topic, place, each.constraints, is_shared=True)


def _stream_uses(inputs: LintInputs) -> Iterator[TopicUse]:
    """Yield the topics that streams are made from, with the constraints on all their samples."""
    for place, declaration in streams_of(inputs):
        terms = list(subterms(declaration.stream))
        by_key = _read_by_key(terms)
        for term in terms:
            if isinstance(term, StreamReference) and term.is_topic:
                topic, is_element = absolute_topic(term.name), term.name in by_key
                yield TopicUse(topic, place, term.constraints, is_element=is_element)
            elif isinstance(term, Select) and not (term.conditions or term.elements):
                for each in term.inputs:
                    if isinstance(each, StreamReference) and each.is_topic:
                        topic, is_element = absolute_topic(each.name), each.name in by_key
                        yield TopicUse(topic, place, term.constraints, is_element=is_element)


def _read_by_key(terms: Iterable[Term]) -> set[str]:
    """Return the topics of which some selections take elements by their keys."""
    found = (
        term
        for term in terms
        if isinstance(term, Select) and any(_has_key(each.field) for each in term.selections)
    )
    return {each.name for term in found for each in references(term) if each.is_topic}


def _has_key(field: str) -> bool:
    """Return True for the path of an element that is found by its key."""
    found = parse_field(field)
    path = found.path if isinstance(found, ComputedField) else found
    return isinstance(path, MessagePath) and any(
        isinstance(step.selector, ElementKey) for step in path.steps
    )


def _may_be_outdated(field: str) -> bool:
    """Return True for the path of an element by its key; formulas over its stamp tell its age."""
    return _has_key(field) and not _STAMP.search(field)


def element_findings(inputs: LintInputs) -> Iterator[Finding]:
    """Yield what reads elements by a key, and does not notice that messages lack them."""
    regular = {each.stream for _, each in annotations_of(inputs) if _is_regular(each.constraints)}
    for source, each in annotations_of(inputs):
        is_element = any(_may_be_outdated(content.field) for content in each.contents)
        if each.is_topic and is_element and not _is_regular(each.constraints):
            yield _unnoticed(inputs.place_of(source), absolute_topic(each.stream))
    for place, declaration in streams_of(inputs):
        terms = list(subterms(declaration.stream))
        is_regular = any(_is_regular(each.constraints) for each in terms)
        if not is_regular and declaration.name not in regular:
            for topic in sorted(_read_by_key(terms)):
                yield _unnoticed(place, absolute_topic(topic))
    for formula in inputs.formulas:
        for topic, field in references_of(formula):
            if _may_be_outdated(field):
                yield _unnoticed(formula.place_of(field), topic)


def _is_regular(constraints: StreamConstraints) -> bool:
    """Return True if the distance of samples is constrained, or they expire."""
    return constraints.max_gap is not None or constraints.sample_period is not None


def _unnoticed(place: FilePlace, topic: str) -> Finding:
    text = (
        f'{topic} is read by a key: if messages come without it, the last value stays in force; '
        'state a max_gap or sample_period in a feature or stream to notice that'
    )
    return warning_at(place, text)
