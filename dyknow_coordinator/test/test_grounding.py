"""From symbols to the specification of a state stream."""

import pytest

from dyknow_common import ExitCode, Symbol, SymbolKind, numbered_names
from dyknow_coordinator import CoordinationError, Grounding
from dyknow_coordinator.grounding.candidate_search import (
    check_symbols,
    concept_query,
    feature_symbols,
    sort_names,
)
from dyknow_coordinator.grounding.feature_sources import (
    Candidates,
    FeatureSource,
    parse_sources,
    referenced_source,
    single_field_source,
)
from dyknow_coordinator.grounding.known_streams import KnownStream, KnownStreams
from dyknow_coordinator.grounding.state_specification import state_specification
from dyknow_stream_processing import SinkDeclaration, StreamReference, Sync, parse_specification

POWER = Symbol(SymbolKind.FEATURE, 'Power', ('UAV',))
DISTANCE = Symbol(SymbolKind.FEATURE, 'XYDist', ('UAV', 'uav1'))
VOLTAGE = Symbol(SymbolKind.FEATURE, '"/uav1/battery".voltage')
UAV = Symbol(SymbolKind.SORT, 'UAV')
UAV1 = Symbol(SymbolKind.OBJECT, 'uav1')


def source(feature: str, stream: str) -> FeatureSource:
    return FeatureSource(
        feature, stream, f'stream {stream} = select v as "{feature}" from {stream}_raw'
    )


def test_features_and_sorts_are_told_apart() -> None:
    symbols = (POWER, UAV, UAV1, DISTANCE)
    assert feature_symbols(symbols) == (POWER, DISTANCE)
    assert sort_names(symbols) == ('UAV',)


@pytest.mark.parametrize(
    ('symbol', 'concept'),
    [
        (POWER, 'Power[object1] for every object1 in UAV'),
        (DISTANCE, 'XYDist[object1, uav1] for every object1 in UAV'),
        (Symbol(SymbolKind.FEATURE, 'Power', ('uav1',)), 'Power[uav1]'),
        (Symbol(SymbolKind.FEATURE, 'Wind'), 'Wind'),
        (
            Symbol(SymbolKind.FEATURE, 'XYDist', ('UAV', 'UAV')),
            'XYDist[object1, object2] for every object1 in UAV, object2 in UAV',
        ),
        (
            Symbol(SymbolKind.FEATURE, 'XYDist', ('UAV', 'object1')),
            'XYDist[object1_2, object1] for every object1_2 in UAV',
        ),
    ],
)
def test_a_feature_is_asked_for_as_a_concept(symbol: Symbol, concept: str) -> None:
    assert concept_query(symbol, ('UAV',)) == concept


def test_syntactic_grounding_refuses_a_feature_of_the_ontology() -> None:
    with pytest.raises(CoordinationError, match=r"'Power\[UAV\]' names no stream"):
        check_symbols((VOLTAGE, POWER), Grounding.SYNTACTIC)


def test_semantic_grounding_refuses_the_name_of_a_stream() -> None:
    with pytest.raises(CoordinationError, match=f"'{VOLTAGE}' names a stream"):
        check_symbols((POWER, VOLTAGE), Grounding.SEMANTIC)


def test_auto_takes_both() -> None:
    check_symbols((POWER, VOLTAGE), Grounding.AUTO)


def test_matches_say_which_ground_feature_they_deliver() -> None:
    text = '# exact match\nstream a = select power as "Power[uav1]" from uav1_power'
    (found,) = parse_sources([text])
    assert (found.feature, found.stream) == ('Power[uav1]', 'a')


@pytest.mark.parametrize(
    ('name', 'field', 'stream', 'is_topic'),
    [
        ('"/uav1/battery".voltage', 'voltage', '/uav1/battery', True),
        ('"/uav1/odom".pose.pose.position.z', 'pose.pose.position.z', '/uav1/odom', True),
        ('"/scan".ranges[0]', 'ranges[0]', '/scan', True),
        ('cloud.points[2].x', 'points[2].x', 'cloud', False),
        ('uav1_power.power', 'power', 'uav1_power', False),
        ('count("/s".a > 1 and "/s".b < 3)', 'count(a > 1 and b < 3)', '/s', True),
        ('any(s.a = "or s.b" or s.b > 1)', 'any(a = "or s.b" or b > 1)', 's', False),
    ],
)
def test_a_reference_selects_its_field(
    name: str, field: str, stream: str, *, is_topic: bool
) -> None:
    made = referenced_source(Symbol(SymbolKind.FEATURE, name))
    assert made.feature == name
    (declaration,) = parse_specification(made.declaration).declarations
    select = declaration.stream
    assert [each.field for each in select.selections] == [field]
    assert [each.name for each in select.selections] == [name]
    assert select.source == StreamReference(stream, is_topic)


def test_the_first_source_found_is_the_best() -> None:
    found = [source('Power[uav1]', 'a'), source('Power[uav1]', 'b'), source('Power[uav2]', 'c')]
    assert Candidates(tuple(found)).choose(['Power[uav2]', 'Power[uav1]']) == (found[0], found[2])


def test_every_missing_ground_feature_is_named() -> None:
    with pytest.raises(CoordinationError) as caught:
        Candidates((source('Power[uav1]', 'a'),)).choose(
            ['Power[uav1]', 'Power[uav2]', 'Speed[uav1]']
        )
    assert caught.value.code is ExitCode.NOT_FOUND
    assert 'Power[uav2], Speed[uav1] (there are streams for Power[uav1])' in str(caught.value)


def test_what_came_nearest_is_told_for_each_missing_feature() -> None:
    nearest = {'Power[UAV]': 'rover carries Powers', 'Speed[UAV]': 'nothing is like Speed'}
    with pytest.raises(CoordinationError) as caught:
        Candidates((), nearest).choose(['Power[uav1]'])
    assert 'rover carries Powers' in str(caught.value)
    assert 'nothing is like Speed' not in str(caught.value)


def test_preferences_choose_among_sources_as_far_as_they_can() -> None:
    first, second, third = (source('Power[uav1]', name) for name in 'abc')
    candidates = Candidates((first, second, third))

    def chosen(failed: set[FeatureSource], there: set[FeatureSource]) -> FeatureSource:
        (found,) = candidates.choose(
            ['Power[uav1]'], lambda each: each not in failed, lambda each: each in there
        )
        return found

    assert chosen(set(), {first, second, third}) == first
    assert chosen({first}, {first, second, third}) == second
    assert chosen({first}, {first, third}) == third
    assert chosen({first}, {first}) == second
    assert chosen({first, second, third}, {second}) == first


def test_a_stream_of_one_field_needs_no_field() -> None:
    made = single_field_source(Symbol(SymbolKind.FEATURE, 'uav1_power'), ['power'])
    assert str(made) == 'select power as uav1_power from uav1_power'
    assert made.feature == 'uav1_power'
    assert made.grounding is Grounding.SYNTACTIC


@pytest.mark.parametrize('fields', [(), ('a', 'b')])
def test_a_stream_of_several_fields_needs_one(fields: tuple[str, ...]) -> None:
    with pytest.raises(CoordinationError, match=r'uav1_state\.field') as caught:
        single_field_source(Symbol(SymbolKind.FEATURE, 'uav1_state'), fields)
    assert caught.value.code is ExitCode.INVALID_ARGUMENT
    assert ', '.join(fields) in str(caught.value)


def test_streams_of_one_name_get_names_of_their_own() -> None:
    texts = ('"/a_b".c', '"/a/b".c', '"/a/b".c')
    chosen = [referenced_source(Symbol(SymbolKind.FEATURE, text)) for text in texts]
    *streams, sink = parse_specification(state_specification(chosen)).declarations
    assert [str(each.stream.source) for each in streams] == ['"/a_b"', '"/a/b"']
    assert sink == SinkDeclaration(Sync(tuple(StreamReference(each.name) for each in streams)))


def test_of_many_streams_of_one_name_each_number_is_tried_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    tried: list[str] = []
    numbers = (tried.append(each) or each for each in numbered_names('a'))
    monkeypatch.setattr('dyknow_common.symbol.numbered_names', lambda _: numbers)
    streams = [
        parse_sources([f'stream a = select x as "X[{each}]" from "/{each}"'])[0] for each in 'rstu'
    ]
    text = state_specification(streams)
    assert text.endswith('sink sync(a, a_2, a_3, a_4)')
    assert tried == ['a', 'a_2', 'a_3', 'a_4']


def test_the_state_stream_synchronises_all_sources() -> None:
    text = state_specification([source('Power[uav1]', 'a'), source('Power[uav2]', 'b')])
    *streams, sink = parse_specification(text).declarations
    assert [stream.name for stream in streams] == ['a', 'b']
    assert sink == SinkDeclaration(Sync((StreamReference('a'), StreamReference('b'))))


def test_features_of_one_stream_share_a_select() -> None:
    texts = [
        f'stream {name} = select {field} as "{feature}" from {origin}'
        for name, field, feature, origin in (
            ('a', 'dock', 'distance[r1, dock]', 'r1_distances'),
            ('b', 'gate', 'distance[r1, gate]', 'r1_distances'),
            ('c', 'gate', 'distance[r2, gate]', 'r2_distances'),
            ('d', 'gate', 'distance[r3, gate]', 'fleet where id = "r3"'),
            ('e', 'dock', 'distance[r4, dock]', 'fleet where id = "r4"'),
            ('f', 'x', 'X[r1]', '"/r1/pose"'),
            ('g', 'y', 'Y[r1]', '"/r1/pose"'),  # A message may lack one of them.
        )
    ]
    sources = parse_sources(texts)
    *streams, sink = parse_specification(state_specification(sources)).declarations
    assert [str(each) for each in streams] == [
        (
            'stream a = select dock as "distance[r1, dock]", gate as "distance[r1, gate]" '
            'from r1_distances'
        ),
        *texts[2:],
    ]
    assert str(sink) == 'sink sync(a, c, d, e, f, g)'
    known = KnownStreams([KnownStream('r1_distances')], lambda _: True)
    assert known.affected(sources, 'r1_distances') == sources[:2]


def test_computational_units_are_declared_once() -> None:
    unit = 'compunit value: float convert(value: float)'
    texts = [
        f'# converted\n{unit};\nstream {name} = select value as "Altitude[{name}]" '
        f'from convert(select z as value from laser, given = "ft", wanted = "m");'
        for name in ('uav1', 'uav2')
    ]
    text = state_specification(parse_sources(texts))
    specification = parse_specification(text)
    assert text.count('compunit') == 1
    assert str(specification.declarations[0]) == unit
    assert isinstance(specification.declarations[-1], SinkDeclaration)
