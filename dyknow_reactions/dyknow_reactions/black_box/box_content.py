"""The metadata of a black box: the formula, and the sources of its states."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from dyknow_common import NO_CONSTRAINTS, DyKnowError, StreamConstraints, round_time
from dyknow_coordinator import (
    EvaluationStatus,
    KnownStream,
    KnownStreams,
    feature_symbols,
    parse_sources,
    with_units,
)
from dyknow_reactions.black_box.failures import FormulaFailure, OpenBox
from dyknow_reasoning import FormulaGroup
from dyknow_recordings import BlackBoxContent, horizon
from dyknow_stream_processing import (
    SinkDeclaration,
    StreamDeclaration,
    StreamReference,
    free_names,
    in_namespace,
    made,
    parse_specification,
)


class RecordedStateNumber(NamedTuple):
    """A state of a state stream: the stream, its number in it, and its valid time."""

    stream_id: int
    number: int
    valid_time: int


@dataclass(frozen=True, slots=True)
class StateOrigin:
    """The sources of a formula's states.

    Args:
        states: the specification of its state stream.
        constraints: the constraints of the state stream.
        streams: a text for each stream that it names.
    """

    states: str = ''
    constraints: StreamConstraints = NO_CONSTRAINTS
    streams: tuple[str, ...] = ()


def state_origin(topic: str, known: KnownStreams, namespace: str) -> StateOrigin | None:
    """Return what the states on a topic are made of, with absolute names; None if it is unknown.

    Args:
        topic: the state stream.
        known: all streams.
        namespace: the namespace of their relative topics.

    Raises:
        DyKnowError: for a stream that cannot be written as a text by itself.
    """
    states = known.get(topic.rpartition('/')[2])
    if states is None or not states.specification:
        return None
    texts: dict[str, str] = {}
    pending = sorted(free_names(parse_specification(states.specification)).streams)
    while pending:
        name = pending.pop()
        stream = known.get(name)
        if stream is None or name in texts:
            continue
        texts[name] = stream_text(stream, namespace)
        if stream.specification:
            pending += sorted(free_names(parse_specification(stream.specification)).streams)
    specification = in_namespace(states.specification, namespace, '/')
    return StateOrigin(specification, states.constraints, tuple(texts.values()))


def stream_text(stream: KnownStream, namespace: str) -> str:
    """Return a text in the stream language whose only sink is a stream, by its name.

    Raises:
        DyKnowError: if its specification has another stream of this name in it.
    """
    name = stream.name
    if not stream.specification:
        return f'stream {name} = "{stream.topic}";\nsink {name}'
    parsed = parse_specification(in_namespace(stream.specification, namespace, '/'))
    declared = {each.name: each.stream for each in parsed.declared(StreamDeclaration)}
    term = made(parsed)
    if isinstance(term, StreamReference) and not term.is_topic and term.name == name in declared:
        own = declared[name]
        term = replace(own, constraints=own.constraints.merged(term.constraints))
    elif name in declared and declared[name] != term:
        raise DyKnowError(f"the stream '{name}' contains another stream of this name")
    term = replace(term, constraints=term.constraints.merged(stream.constraints))
    others = [
        str(each)
        for each in parsed.declarations
        if not isinstance(each, SinkDeclaration)
        and not (isinstance(each, StreamDeclaration) and each.name == name)
    ]
    return ';\n'.join([*others, f'stream {name} = {term}', f'sink {name}'])


def objects_fault(formula: str, domains: Mapping[str, Sequence[str]], states: str) -> str:
    """Return how objects differ from the objects in a formula's states; empty if they do not."""
    group = FormulaGroup()
    group.add_formula(formula, formula)
    group.begin({sort: tuple(objects) for sort, objects in domains.items()})
    needed = {str(each) for each in feature_symbols(group.symbols())}
    if needed == {each.feature for each in parse_sources([states])}:
        return ''
    return 'the objects have changed since the formula was requested; give them by --domain'


def first_state(
    states: Sequence[RecordedStateNumber], progressed: int, latest: int | None, requested: int
) -> tuple[int | None, bool]:
    """Return the valid time of the first recorded state of a formula, and if it is its first one.

    Example: 3 states up to 30 were progressed. The recorded states have the numbers 4, 5, 6 and
    7; number 6 is valid at 30. So the formula began with number 4, which is recorded. Had 5 states
    been progressed, it would have begun with number 2.

    Args:
        states: the recorded states, in their order.
        progressed: the number of states of the formula ...
        latest: ... up to the state that is valid at this time; None before its first state.
        requested: the time at which the formula was requested. All times are in nanoseconds.
    """
    last = next((each for each in states if each.valid_time == latest), None)
    if last is None or not progressed:
        return min(
            (each.valid_time for each in states if each.valid_time >= requested), default=None
        ), False
    first = last.number - progressed + 1
    own = [each for each in states if each.stream_id == last.stream_id and each.number >= first]
    return own[0].valid_time, own[0].number == first


@dataclass(slots=True)
class FormulaOrigin:
    """The knowledge about the states of a watched formula.

    Args:
        status: the latest one with a state, or the first.
        group_id: the group id of its states at the reasoning engine; 0 before they are asked for.
        reported_stream: the latest state stream that was reported.
        state_stream: the state stream whose origin is known.
        origin: the origin of this stream.
        domains: the objects of each sort; None before they are known.
        units: the units of its features that its text does not state.
        topics: all topics that were recorded for it.
        objects_fault: why the objects are not known.
        faults: why something else is not known.
    """

    status: EvaluationStatus
    group_id: int = 0
    reported_stream: str = ''
    state_stream: str = ''
    origin: StateOrigin = field(default_factory=StateOrigin)
    domains: Mapping[str, Sequence[str]] | None = None
    units: Mapping[str, str] = field(default_factory=dict)
    topics: set[str] = field(default_factory=set)
    objects_fault: str = 'the objects of the sorts were not known yet'
    faults: set[str] = field(default_factory=set)

    @property
    def has_streams(self) -> bool:
        """True if the origin of the latest state stream is known, or there is no state stream."""
        return self.state_stream == self.reported_stream

    @property
    def is_known(self) -> bool:
        """True if a black box has all that its check needs beside messages."""
        return bool(self.state_stream) and self.has_streams and self.domains is not None


def content_of(
    box: OpenBox,
    origin: FormulaOrigin,
    states: Sequence[RecordedStateNumber],
    versions: Mapping[str, str],
    configuration: Mapping[str, str],
) -> BlackBoxContent:
    """Return the content of a black box.

    Args:
        box: the box.
        origin: the origin of its formula.
        states: the recorded states.
        versions: the versions of the programs.
        configuration: texts that the system was configured with.
    """
    status, failure, latest = box.status, box.failure, origin.status
    begin, is_complete = first_state(
        states, latest.states_progressed, latest.latest_valid_time, status.started
    )
    return BlackBoxContent(
        name=status.name,
        formula=with_units(status.formula, origin.units),
        reason=failure.reason,
        verdict='false' if failure.reason in {'false', 'episode'} else '',
        explanation=failure.explanation,
        decided_at=failure.decided_at,
        every_state=status.episodes is not None,
        margin=status.margin is not None,
        begin=begin,
        is_complete=is_complete,
        states=origin.origin.states if origin.has_streams else '',
        constraints=str(_with_phase(origin.origin.constraints, begin, box.begin)),
        streams=origin.origin.streams,
        domains=origin.domains or {},
        faults=_faults(box, origin, begin if is_complete else None),
        versions=versions,
        configuration=configuration,
    )


def lack_of_messages(
    formula: str, failure: FormulaFailure, first: int | None, recorded_from: int
) -> str:
    """Return that a failure may depend on messages from before the recording; empty if it does not.

    Args:
        formula: its canonical text.
        failure: the recorded failure.
        first: the valid time of its first state, if that is recorded, nanoseconds.
        recorded_from: the time from which all its topics are received.
    """
    if failure.decided_at is None or (first is not None and first >= recorded_from):
        return ''
    try:
        begin = failure.decided_at - horizon(formula)
    except DyKnowError:  # Reports have the begin of a long text only.
        begin = failure.decided_at
    if begin >= recorded_from:
        return ''
    return (
        f'the topics of the formula are recorded from {round_time(recorded_from)} on, after states '
        'that its verdict depends on: messages may be missing'
    )


def _faults(box: OpenBox, origin: FormulaOrigin, first: int | None) -> Sequence[str]:
    formula = box.status.formula
    faults = {*origin.faults, lack_of_messages(formula, box.failure, first, box.recorded_from)}
    has_states = origin.has_streams and origin.origin.states
    if not has_states:
        faults.add('the stream manager had not reported the streams of the formula')
    if origin.domains is None:
        faults.add(origin.objects_fault)
    elif has_states:
        faults.add(objects_fault(formula, origin.domains, origin.origin.states))
    return sorted(faults - {''})


def _with_phase(constraints: StreamConstraints, state: int | None, begin: int) -> StreamConstraints:
    """Return constraints under which periodic states have the valid times that they had.

    Args:
        constraints: the constraints of the states.
        state: the valid time of one of them, nanoseconds.
        begin: the begin of the recording.
    """
    period = constraints.sample_period
    if period is None or state is None or constraints.start_time is not None:
        return constraints
    before = max(state - begin, 0) // period + 1
    return replace(constraints, start_time=max(state - before * period, state % period))
