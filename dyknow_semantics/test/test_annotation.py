"""SSL: what its texts mean, and that every annotation survives being written and read."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import NO_CONSTRAINTS, ElementCondition, StreamConstraints, TextPosition
from dyknow_semantics import (
    Annotation,
    Concept,
    Content,
    FeatureArgument,
    FeatureTerm,
    Key,
    Range,
    parse_annotations,
    parse_concept,
)

MILLISECOND = 1_000_000


def feature(name: str, *arguments: str) -> FeatureTerm:
    return FeatureTerm(name, tuple(map(FeatureArgument, arguments)))


def test_a_stream_of_one_object() -> None:
    assert parse_annotations('stream uav1_power contains Power[uav1] = power;') == (
        Annotation('uav1_power', (Content(feature('Power', 'uav1'), 'power'),)),
    )


def test_a_topic_of_many_objects() -> None:
    text = """
        stream "/fleet" contains  # everything about every UAV
            Altitude[u] = pose.position.z [m], Speed[u] = speed [ m/s ]
            for every u in UAV where u = id
            with max_delay = 0.1 s, sample_period = 200
    """
    assert parse_annotations(text) == (
        Annotation(
            '/fleet',
            (
                Content(feature('Altitude', 'u'), 'pose.position.z', 'm'),
                Content(feature('Speed', 'u'), 'speed', 'm/s'),
            ),
            (Range('u', 'UAV'),),
            (Key('u', 'id'),),
            StreamConstraints(max_delay=100 * MILLISECOND, sample_period=200 * MILLISECOND),
            is_topic=True,
        ),
    )


def test_several_variables_and_statements() -> None:
    first, second = parse_annotations(
        'stream ranges contains XYDist[a, b] = distance '
        'for every a in UAV, b in vehicles:UGV where a = first, b = second;\n'
        'stream sky contains Daylight = "is light"'
    )
    assert first.ranges == (Range('a', 'UAV'), Range('b', 'vehicles:UGV'))
    assert first.keys == (Key('a', 'first'), Key('b', 'second'))
    assert second == Annotation('sky', (Content(feature('Daylight'), 'is light'),))


def test_canonical_text() -> None:
    text = (
        'stream "/fleet" contains Altitude[u] = pose.z [m] unless status.fix <= 0, '
        'Power["uav-1"] = "Power[uav-1]" '
        'for every u in UAV where u = id with max_delay = 100 ms;'
    )
    assert ''.join(map(str, parse_annotations(text.replace(' ', '\n')))) == text


def test_words_keep_their_places() -> None:
    (annotation,) = parse_annotations(
        'stream a contains\n  Power[u] = p [W]\n  for every u in UAV\n  where u = id'
    )
    content = annotation.contents[0]
    assert content.feature.position == TextPosition(2, 3)
    assert content.feature.arguments[0].position == TextPosition(2, 9)
    assert content.unit_position == TextPosition(2, 16)
    assert (annotation.ranges[0].position, annotation.ranges[0].sort_position) == (
        TextPosition(3, 13),
        TextPosition(3, 18),
    )
    assert annotation.keys[0].position == TextPosition(4, 9)


def test_concepts() -> None:
    assert parse_concept('Power') == Concept(feature('Power'))
    for text in ('Power[uav1]', 'Power(uav1)'):
        assert parse_concept(text) == Concept(feature('Power', 'uav1'))
    assert parse_concept('XYDist[x, uav1] for every x in UAV') == Concept(
        feature('XYDist', 'x', 'uav1'), (Range('x', 'UAV'),)
    )


def test_words_of_the_language_may_be_names_where_nothing_is_unclear() -> None:
    (annotation,) = parse_annotations('stream stream contains every[in] = stream.every')
    assert annotation == Annotation('stream', (Content(feature('every', 'in'), 'stream.every'),))


def test_an_index_is_part_of_the_field_and_a_unit_is_not() -> None:
    text = (
        'stream "/scan" contains Range = ranges[0] [m], Count = points[2].n[1], Share = share [1]'
    )
    (annotation,) = parse_annotations(text)
    found = [(each.field, each.unit) for each in annotation.contents]
    assert found == [('ranges[0]', 'm'), ('points[2].n[1]', None), ('share', '1')]


RESERVED = {'for', 'where', 'with', 'contains'}
NAMES = st.from_regex(r'[A-Za-z_][A-Za-z0-9_]{0,6}', fullmatch=True).filter(
    lambda name: name not in RESERVED
)
CONCEPTS = NAMES | st.builds('{}:{}'.format, NAMES, NAMES)
TEXTS = st.text(st.characters(exclude_characters='\0', codec='utf-8'), max_size=8)
PARTS = NAMES | st.builds('{}[{}]'.format, NAMES, st.integers(0, 99))
FIELDS = st.lists(PARTS, min_size=1, max_size=3).map('.'.join) | TEXTS
UNITS = st.none() | st.from_regex(r'[A-Za-z%°/^0-9*-]{0,6}', fullmatch=True)
DURATIONS = st.none() | st.integers(min_value=1, max_value=10**12)
PLACES = st.lists(CONCEPTS | TEXTS, max_size=3)
UNLESS = st.none() | st.tuples(
    FIELDS, st.builds(ElementCondition, st.sampled_from(('<', '=', '!=')), st.integers(-9, 9))
)
FEATURES = st.builds(lambda name, places: feature(name, *places), CONCEPTS, PLACES)
RANGES = st.lists(st.builds(Range, NAMES, CONCEPTS), max_size=3, unique_by=lambda r: r.variable)


@st.composite
def annotations(draw: st.DrawFn) -> Annotation:
    ranges = tuple(draw(RANGES))
    is_topic = draw(st.booleans())
    period = draw(DURATIONS)
    deviation = None if period is None else draw(st.none() | st.integers(0, period))
    return Annotation(
        draw(TEXTS if is_topic else NAMES),
        tuple(
            draw(
                st.lists(
                    st.builds(Content, FEATURES, FIELDS, UNITS, UNLESS), min_size=1, max_size=3
                )
            )
        ),
        ranges,
        tuple(Key(each.variable, draw(FIELDS)) for each in ranges),
        StreamConstraints(
            max_delay=draw(DURATIONS),
            sample_period=period,
            sample_period_deviation=deviation,
            max_lead=draw(DURATIONS),
            max_gap=draw(st.none() | st.integers(period or 1, 10**13)),
        )
        if draw(st.booleans())
        else NO_CONSTRAINTS,
        is_topic=is_topic,
    )


@given(st.lists(annotations(), min_size=1, max_size=3))
def test_annotations_survive_writing_and_reading(written: list[Annotation]) -> None:
    assert parse_annotations('\n'.join(map(str, written))) == tuple(written)


@given(FEATURES, RANGES)
def test_concepts_survive_writing_and_reading(term: FeatureTerm, ranges: list[Range]) -> None:
    concept = Concept(term, tuple(ranges))
    assert parse_concept(str(concept)) == concept
