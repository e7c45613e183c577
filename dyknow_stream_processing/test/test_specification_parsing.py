"""The stream language: every text that is printed reads back as the same."""

from __future__ import annotations

import re
from enum import StrEnum
from importlib.util import find_spec

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import (
    MAX_DURATION_NS,
    NO_CONSTRAINTS,
    TEXT_COMPARISONS,
    LanguageError,
    StreamConstraints,
    ValueType,
)
from dyknow_stream_processing import (
    Approximation,
    BuiltInSource,
    Call,
    Condition,
    Merge,
    Select,
    Selection,
    SinkDeclaration,
    SourceDeclaration,
    Specification,
    StreamDeclaration,
    StreamReference,
    Sync,
    Term,
    TypedField,
    UnitArgument,
    UnitDeclaration,
    free_names,
    made,
    parse_specification,
)
from dyknow_stream_processing.language.specification import (
    LANGUAGE,
    Assignment,
    BuiltIn,
    SinkMessage,
)

EXAMPLE = """
source (pose.pose.position.z: float, twist.twist.linear.x: float) "/uav1/odometry";  # a comment
compunit power: float electrical_power((voltage: float, current: float));
stream uav1_altitude = select pose.pose.position.z as altitude from "/uav1/odometry"
    with max_delay = 100 ms;
stream uav1_power = electrical_power(select voltage, current from "/uav1/battery");
stream uav1_state = sync(uav1_altitude, uav1_power)
    with sample_period = 200 ms, sample_period_deviation = 0 ms;
sink uav1_state
"""

unit_names = st.sampled_from(['a', 'b', 'mean'])
names = st.sampled_from(['a', 'b', 'tf', 'action', 'uav1_power', 'S1', '_x'])
field_names = st.sampled_from(
    [
        'a',
        'pose.position.z',
        'points[2].x',
        'ranges[0]',
        'from',
        'int',
        'Power[uav1]',
        'ä "x"',
        '1',
        "F'",
    ]
)
durations = st.integers(0, MAX_DURATION_NS)
texts = st.text(st.characters(exclude_characters='\0', codec='utf-8'))
values = st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | texts


@st.composite
def constraints(draw: st.DrawFn) -> StreamConstraints:
    start = draw(st.none() | st.integers(0, MAX_DURATION_NS))
    end = draw(st.none() | durations)
    period = draw(st.none() | st.integers(1, 10**12))
    return StreamConstraints(
        start_time=start,
        end_time=end if start is None or end is None else max(start, end),
        max_delay=draw(st.none() | durations),
        sample_period=period,
        sample_period_deviation=draw(st.none() | st.integers(0, period)) if period else None,
        max_lead=draw(st.none() | durations),
        max_gap=draw(st.none() | st.integers(period or 1, 10**13)),
    )


some_constraints = st.just(NO_CONSTRAINTS) | constraints()
renamings = st.sampled_from(
    [None, 'F%C%', '%id%', 'x.y', 'Power[%id%]', 'a b', '%pose.x%_%y%', '1', "F'", "F'%C'%"]
)
references = st.builds(StreamReference, names, constraints=some_constraints) | st.builds(
    StreamReference, texts.filter(bool), st.just(True), constraints=some_constraints
)
frames = st.lists(
    texts.filter(lambda name: name and name[0] != '/'), min_size=2, max_size=2, unique=True
)
references |= st.builds(
    BuiltInSource, st.just(BuiltIn.TF), frames.map(tuple), constraints=some_constraints
) | st.builds(
    BuiltInSource,
    st.just(BuiltIn.ACTION),
    st.tuples(texts.filter(lambda name: name.strip('/'))),
    constraints=some_constraints,
)
references |= st.builds(
    BuiltInSource,
    st.just(BuiltIn.RATE),
    st.tuples(texts.filter(lambda name: name.strip('/'))),
    st.sampled_from([10_000_000, 2_000_000_000, 60_000_000_000]),
    constraints=some_constraints,
)
selections = st.lists(st.builds(Selection, field_names, renamings), min_size=1, max_size=3)
conditions = st.builds(
    Condition, field_names, st.sampled_from(['=', '!=', '<', '<=', '>', '>=']), values
) | st.builds(Condition, field_names, st.sampled_from([*TEXT_COMPARISONS]), texts)


arguments = st.lists(
    st.builds(UnitArgument, names, values)
    | st.builds(UnitArgument, names, durations, st.just(True)),
    max_size=2,
)


def _compound(terms: st.SearchStrategy[Term]) -> st.SearchStrategy[Term]:
    inputs = st.lists(terms, min_size=1, max_size=3).map(tuple)
    return (
        st.builds(Merge, inputs, constraints=some_constraints)
        | st.builds(Sync, inputs, st.sampled_from(Approximation), constraints=some_constraints)
        | st.builds(Call, unit_names, inputs, arguments.map(tuple), constraints=some_constraints)
        | st.builds(
            Select,
            selections.map(tuple),
            terms,
            st.lists(conditions, max_size=2).map(tuple),
            constraints=some_constraints,
        )
    )


terms = st.recursive(references, _compound, max_leaves=6)
typed_fields = st.builds(TypedField, field_names, st.sampled_from(ValueType))
field_lists = st.lists(typed_fields, min_size=1, max_size=3, unique_by=lambda each: each.name)
assignments = st.builds(
    Assignment, st.sampled_from(['a', 'point.x', 'data[1]']), st.sampled_from(['b', 'p.x[0]'])
) | st.builds(
    Assignment,
    st.sampled_from(['c', 'header.frame_id']),
    constant=st.integers() | st.floats(allow_nan=False, allow_infinity=False) | texts,
)
publications = st.builds(
    SinkMessage,
    st.sampled_from(['std_msgs/msg/Float64', 'a/msg/B2']),
    st.lists(assignments, max_size=3, unique_by=lambda each: each.path).map(tuple),
    texts,
)
declarations = (
    st.builds(SourceDeclaration, names | texts.filter(bool), field_lists.map(tuple))
    | st.builds(
        UnitDeclaration,
        unit_names,
        field_lists.map(tuple),
        st.lists(field_lists.map(tuple), min_size=1, max_size=3).map(tuple),
    )
    | st.builds(StreamDeclaration, names, terms)
    | st.builds(SinkDeclaration, terms, st.none() | publications)
)


@given(st.lists(declarations, min_size=1, max_size=4))
def test_the_canonical_text_reads_back(written: list[SinkDeclaration]) -> None:
    specification = Specification(tuple(written))
    assert parse_specification(str(specification)) == specification


def test_the_example_of_the_design_reads_back() -> None:
    specification = parse_specification(EXAMPLE)
    assert parse_specification(str(specification)) == specification
    assert str(specification.declarations[4]) == (
        'stream uav1_state = sync(uav1_altitude, uav1_power) '
        'with sample_period = 200 ms, sample_period_deviation = 0 s'
    )
    assert made(specification) == StreamReference('uav1_state')


@pytest.mark.parametrize(
    ('text', 'canonical'),
    [
        ('select a from b;', 'sink select a from b'),
        ('merge(a, "/b")', 'sink merge(a, "/b")'),
        ('a with max_delay = 100', 'sink a with max_delay = 100 ms'),
        ('a with start_time = 1.5 s', 'sink a with start_time = 1500 ms'),
        # Constraints belong to the select, unless conditions or more constraints follow.
        (
            'select a from b with max_delay = 1',
            'sink select a from b with max_delay = 1 ms',
        ),
        (
            'select a from b with max_delay = 1 where c = 2 with max_delay = 3',
            'sink select a from (b with max_delay = 1 ms) where c = 2 with max_delay = 3 ms',
        ),
        (
            'select a from b with max_delay = 1 with max_delay = 3',
            'sink select a from (b with max_delay = 1 ms) with max_delay = 3 ms',
        ),
        (
            (
                'select a from select b from c with max_delay = 1 where d = 1 with max_delay = 2 '
                'where e = 2 with max_delay = 3'
            ),
            (
                'sink select a from (select b from (c with max_delay = 1 ms) where d = 1 '
                'with max_delay = 2 ms) where e = 2 with max_delay = 3 ms'
            ),
        ),
        # The comma of a constraint list and the comma of a list of streams.
        (
            'sync(a with max_delay = 1, # a comment\n sample_period = 2, b, max_delay)',
            'sink sync(a with max_delay = 1 ms, sample_period = 2 ms, b, max_delay)',
        ),
        (
            '(a with max_delay = 5) with end_time = 0',
            'sink a with end_time = 0 s, max_delay = 5 ms',
        ),
        (
            'sync(a, b) with approximation = linear, max_delay = 5',
            'sink sync(a, b) with max_delay = 5 ms, approximation = linear',
        ),
        ('sync(a, b) with approximation = latest', 'sink sync(a, b)'),
        (
            'select a from (sync(a, b) with approximation = linear) with max_delay = 5',
            'sink select a from (sync(a, b) with approximation = linear) with max_delay = 5 ms',
        ),
        (
            'mean(a, window = 5 s, n = 1, x = -2e3, t = "b", f = true)',
            'sink mean(a, window = 5 s, n = 1, x = -2000.0, t = "b", f = true)',
        ),
        ('select power as "Power[uav1]" from p', 'sink select power as "Power[uav1]" from p'),
        ('select D as F%C% from S1 where B = 2', 'sink select D as F%C% from S1 where B = 2'),
        (
            'select a from b where c != "x" and d <= -2.5e3 and "e f" = false',
            'sink select a from b where c != "x" and d <= -2500.0 and "e f" = false',
        ),
        (
            'select a as b unless c<0, d unless f = "x" from e where g = 1',
            'sink select a as b unless c < 0, d unless f = "x" from e where g = 1',
        ),
        ('tf( # a comment\n"/map", "base")', 'sink tf("map", "base")'),
        (
            'sync(tf, tf("a", "b") with max_delay = 1)',
            'sink sync(tf, tf("a", "b") with max_delay = 1 ms)',
        ),
        ('action("dock")', 'sink action("dock")'),
        (
            'sink a as geometry_msgs/msg/Point(x=b,y = -2e0 , z=c.d[1])on "/t"',
            'sink a as geometry_msgs/msg/Point (x = b, y = -2.0, z = c.d[1]) on "/t"',
        ),
        ('source x: float odometry; sink odometry', 'source (x: float) odometry;\nsink odometry'),
    ],
)
def test_canonical_text(text: str, canonical: str) -> None:
    assert str(parse_specification(text)) == canonical


def test_a_single_unused_stream_is_what_is_made() -> None:
    specification = parse_specification('stream a = select x from "t"; stream b = select x from a')
    assert str(made(specification)) == 'select x from a'


def test_free_names() -> None:
    specification = parse_specification(
        'source x: int "declared"; stream a = sync(b, "t", "declared"); sink merge(a, c)'
    )
    free = free_names(specification)
    assert (free.streams, free.topics) == ({'b', 'c'}, {'t'})


@given(st.text(alphabet='select from where with merge(,)="%;.5 ms', max_size=60))
def test_nonsense_is_a_language_error_or_sense(text: str) -> None:
    try:
        specification = parse_specification(text)
    except LanguageError as error:
        assert 'stream specification' in str(error)  # noqa: PT017
    else:
        assert parse_specification(str(specification)) == specification


@given(st.from_regex(LANGUAGE.pattern('FIELD'), fullmatch=True, alphabet='abcZ_019.[]'))
def test_all_paths_are_written_without_quotes(path: str) -> None:
    assert str(parse_specification(f'select {path} as b from c')) == (
        f'sink select {path} as b from c'
    )


@pytest.mark.parametrize(
    ('terminal', 'words'), [('TYPE', ValueType), ('APPROXIMATION', Approximation)]
)
def test_words_of_the_grammar_and_the_code_agree(terminal: str, words: type[StrEnum]) -> None:
    assert set(re.findall('[a-z]+', LANGUAGE.pattern(terminal))) == set(words)


@pytest.mark.skipif(find_spec('action_msgs') is None, reason='the types of ROS are not installed')
@pytest.mark.parametrize(
    'name', ['Marker.MESH_RESOURCE', 'visualization_msgs/msg/Marker.MESH_RESOURCE']
)
def test_constants_of_message_types(name: str) -> None:
    text = f'select any(list.status = {name}) as is_aborted from "/a" where status = {name}'
    plain = text.replace(name, '10')
    assert parse_specification(text) == parse_specification(plain)
    with pytest.raises(LanguageError, match="did you mean 'MESH_RESOURCE'"):
        parse_specification(text.replace('RESOURCE', 'RESORCE'))
    with pytest.raises(LanguageError, match=r'the message type of .* is not installed'):
        parse_specification('select x from "/a" where status = Dock.ON')
