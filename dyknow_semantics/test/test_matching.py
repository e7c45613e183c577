"""Matching, against a reference that lists every ground feature of everything."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace
from itertools import product
from math import inf
from typing import NamedTuple

import pytest
from annotated import matcher_of
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import NO_CONSTRAINTS, LanguageError, StreamConstraints
from dyknow_semantics import (
    Annotation,
    Concept,
    Content,
    FeatureArgument,
    FeatureTerm,
    Key,
    Knowledge,
    Matcher,
    Range,
    match,
    parse_annotations,
    parse_concept,
)
from dyknow_semantics.ontology.vocabulary import CLASS, SUBCLASS_OF, TYPE, UPPER_ONTOLOGY
from dyknow_stream_processing import (
    Condition,
    Dataflow,
    Sample,
    Select,
    Selection,
    StreamDeclaration,
    StreamReference,
    load_units,
    parse_specification,
)

SSL = """
    stream uav1_power contains Power[uav1] = power;
    stream "/fleet" contains Altitude[u] = pose.position.z for every u in UAV where u = id
        with max_delay = 100 ms;
    stream barometer contains BarometricAltitude[uav1] = z with sample_period = 10 ms;
    stream ranges contains XYDist[a, b] = distance for every a in UAV, b in Vehicle
        where a = first, b = second;
    stream laser contains Height[uav2] = z with sample_period = 20 ms;
    stream sky contains Daylight = light;
"""


def specifications(concept: str, knowledge: Knowledge, ssl: str = SSL) -> list[str]:
    found = match(parse_concept(concept), parse_annotations(ssl), knowledge)
    return [each.specification for each in found]


def test_a_stream_of_the_object(knowledge: Knowledge) -> None:
    for concept in ('Power[uav1]', 'Power[u] for every u in UAV', 'Power'):
        assert '\n'.join(specifications(concept, knowledge)) == (
            '# exact match: uav1_power carries Power[uav1]\n'
            'stream Power_uav1_from_uav1_power = select power as "Power[uav1]" from uav1_power;'
        )


def test_a_stream_of_many_objects_equivalent_features_and_features_below(
    knowledge: Knowledge,
) -> None:
    assert '\n'.join(specifications('Altitude[u] for every u in UAV', knowledge)) == (
        '# exact match: Height is equivalent to Altitude\n'
        'stream Altitude_uav2_from_laser = select z as "Altitude[uav2]" from laser '
        'with sample_period = 20 ms;\n'
        '# exact match: "/fleet" carries Altitude[uav1]\n'
        'stream Altitude_uav1_from_fleet = select pose.position.z as "Altitude[uav1]" '
        'from "/fleet" where id = "uav1" with max_delay = 100 ms;\n'
        '# exact match: "/fleet" carries Altitude[uav2]\n'
        'stream Altitude_uav2_from_fleet = select pose.position.z as "Altitude[uav2]" '
        'from "/fleet" where id = "uav2" with max_delay = 100 ms;\n'
        '# subsumed: BarometricAltitude is below Altitude\n'
        'stream Altitude_uav1_from_barometer = select z as "Altitude[uav1]" from barometer '
        'with sample_period = 10 ms;'
    )


def test_an_object_and_a_variable(knowledge: Knowledge) -> None:
    assert '\n'.join(specifications('XYDist[x, rover] for every x in UAV', knowledge)) == (
        '# exact match: ranges carries XYDist[uav1, rover]\n'
        'stream XYDist_uav1_rover_from_ranges = select distance as "XYDist[uav1, rover]" '
        'from ranges where first = "uav1" and second = "rover";\n'
        '# exact match: ranges carries XYDist[uav2, rover]\n'
        'stream XYDist_uav2_rover_from_ranges = select distance as "XYDist[uav2, rover]" '
        'from ranges where first = "uav2" and second = "rover";'
    )


def test_a_feature_of_the_world_as_a_whole(knowledge: Knowledge) -> None:
    (specification,) = specifications('Daylight', knowledge)
    assert specification == (
        '# exact match: sky carries Daylight\n'
        'stream Daylight_from_sky = select light as Daylight from sky;'
    )


def test_names_are_unique_and_matches_name_their_feature(knowledge: Knowledge) -> None:
    ssl = """stream a contains Power[uav1] = p, Power[uav1] = q;
             stream "/a" contains Power[uav1] = p, BarometricAltitude[uav1] = z"""
    found = match(parse_concept('Power[uav1]'), parse_annotations(ssl), knowledge)
    assert [each.stream_name for each in found] == [
        'Power_uav1_from_a', 'Power_uav1_from_a_2', 'Power_uav1_from_a_3',
    ]  # fmt: skip
    assert {each.ground_feature for each in found} == {'Power[uav1]'}


def test_invalid_annotations_match_nothing(knowledge: Knowledge) -> None:
    ssl = 'stream a contains Power[uav9] = p, Power[uav1] = q; stream b contains Powr[uav1] = r'
    assert specifications('Power[uav1]', knowledge, ssl) == []


def test_an_invalid_concept(knowledge: Knowledge) -> None:
    for search in (match, nearest):
        with pytest.raises(LanguageError, match="unknown concept 'Powr'"):
            search(parse_concept('Powr[uav1]'), parse_annotations(SSL), knowledge)


@pytest.mark.parametrize(
    ('concept', 'ssl', 'message'),
    [
        ('Power[uav2]', SSL, '; nearest: uav1_power carries Power[uav1]'),
        ('Power[rover]', 'stream a contains Power[u] = p for every u in UAV where u = id',
         '; nearest: a carries Power[u] for every u in UAV'),
        ('XYDist[uav1, rover]',
         'stream b contains XYDist[uav2, rover] = d; stream a contains XYDist[uav2, uav1] = d',
         '; nearest: b carries XYDist[uav2, rover]'),
        ('BarometricAltitude[uav2]', 'stream "/f" contains Altitude[uav2] = z',
         '; nearest: "/f" carries Altitude[uav2]'),
        ('BarometricAltitude[uav2]', SSL, '; nearest: barometer carries BarometricAltitude[uav1]'),
        ('Power[uav2]', 'stream a contains Daylight = d, Altitude[uav1] = z',
         '; the annotated streams carry Altitude, Daylight'),
        ('Power[uav2]', '# nothing\nstream a contains Powr[uav1] = p',
         ', since no stream is annotated'),
    ],
)  # fmt: skip
def test_the_nearest_field(knowledge: Knowledge, concept: str, ssl: str, message: str) -> None:
    assert specifications(concept, knowledge, ssl) == []
    assert nearest(parse_concept(concept), parse_annotations(ssl), knowledge) == (
        f'no stream carries {concept}{message}'
    )


def nearest(concept: Concept, annotations: Iterable[Annotation], knowledge: Knowledge) -> str:
    return matcher_of(annotations, knowledge).nearest(concept)


HERE = 'http://www.example.org/here#'

FEATURES = ['F0', 'F1', 'F2', 'F3']
SORTS = ['S0', 'S1', 'S2']
OBJECTS = ['a', 'b', 'c', 'd']
VARIABLES = ['x', 'y']
FIELDS = ['p', 'q']


class World(NamedTuple):
    """A random ontology: each concept with some above it, each object with its sort."""

    above: list[tuple[str, str]]
    sorts: Mapping[str, str]

    def knowledge(self) -> Knowledge:
        """The ontology as triples; every feature has two arguments of sort S0, the top one."""
        triples = [(HERE + name, TYPE, CLASS) for name in FEATURES + SORTS]
        triples += [(HERE + each, SUBCLASS_OF, UPPER_ONTOLOGY + 'Feature') for each in FEATURES]
        triples += [(HERE + one, SUBCLASS_OF, HERE + other) for one, other in self.above]
        triples += [(HERE + each, TYPE, HERE + sort) for each, sort in self.sorts.items()]
        for each in FEATURES:
            triples += [(HERE + each, f'{UPPER_ONTOLOGY}argument{n}', HERE + 'S0') for n in (1, 2)]
            triples += [(HERE + each, UPPER_ONTOLOGY + 'value_type', 'float')]
        return Knowledge(triples)

    def is_below(self, concept: str, other: str) -> bool:
        """Return True if there is a path upwards, tried step by step."""
        reached = {concept}
        for _ in self.above:
            reached |= {above for below, above in self.above if below in reached}
        return other in reached

    def domain(self, sort: str) -> list[str]:
        """The objects of a sort."""
        return [each for each, own in self.sorts.items() if self.is_below(own, sort)]

    def groundings(
        self, term: FeatureTerm, ranges: Iterable[Range]
    ) -> list[tuple[tuple[str, ...], dict[str, str]]]:
        """Every way to ground a term: its objects, and what its variables stand for."""
        used = {argument.name for argument in term.arguments}
        domains = {
            each.variable: self.domain(each.sort) for each in ranges if each.variable in used
        }
        bindings = [dict(zip(domains, objects)) for objects in product(*domains.values())]  # noqa: B905
        return [
            (tuple(binding.get(each.name, each.name) for each in term.arguments), binding)
            for binding in bindings
        ]


def test_a_feature_above_is_nearer_than_one_beside() -> None:
    world = World([('F1', 'F0'), ('F2', 'F0')], dict.fromkeys(OBJECTS, 'S0'))
    ssl = 'stream s contains F2[a, a] = p; stream t contains F0[b, b] = p'
    message = nearest(parse_concept('F1[a, a]'), parse_annotations(ssl), world.knowledge())
    assert message == 'no stream carries F1[a, a]; nearest: t carries F0[b, b]'


PAIRS = st.lists(
    st.tuples(st.sampled_from(FEATURES), st.sampled_from(FEATURES))
    | st.tuples(st.sampled_from(SORTS), st.sampled_from(SORTS)),
    max_size=6,
)
WORLDS = st.builds(
    lambda above, sorts: World(
        [*above, *((sort, 'S0') for sort in SORTS)], dict(zip(OBJECTS, sorts, strict=True))
    ),
    PAIRS,
    st.lists(st.sampled_from(SORTS), min_size=4, max_size=4),
)
RANGES = st.tuples(*(st.builds(Range, st.just(name), st.sampled_from(SORTS)) for name in VARIABLES))
TERMS = st.builds(
    FeatureTerm,
    st.sampled_from(FEATURES),
    st.lists(st.sampled_from(OBJECTS + VARIABLES).map(FeatureArgument), min_size=2, max_size=2).map(
        tuple
    ),
)
PERIODS = st.none() | st.integers(1, 3)
ANNOTATIONS = st.builds(
    Annotation,
    st.sampled_from(['s', 't']),
    st.lists(st.builds(Content, TERMS, st.sampled_from(FIELDS)), min_size=1, max_size=2).map(tuple),
    RANGES,
    st.just(tuple(Key(name, f'{name}_id') for name in VARIABLES)),
    st.builds(StreamConstraints, max_delay=PERIODS, sample_period=PERIODS),
)


@given(WORLDS, st.lists(ANNOTATIONS, max_size=4), TERMS, RANGES)
def test_matches_are_those_of_the_reference(
    world: World, annotations: list[Annotation], term: FeatureTerm, ranges: tuple[Range, ...]
) -> None:
    expected = []
    asked = {objects for objects, _ in world.groundings(term, ranges)}
    for annotation in {str(each): each for each in annotations}.values():
        for content in annotation.contents:
            carried = content.feature
            for objects, binding in world.groundings(carried, annotation.ranges):
                if world.is_below(carried.name, term.name) and objects in asked:
                    stream = Select(
                        (Selection(content.field, f'{term.name}[{objects[0]}, {objects[1]}]'),),
                        StreamReference(annotation.stream),
                        tuple(
                            Condition(f'{name}_id', '=', binding[name])
                            for name in VARIABLES
                            if name in binding
                        ),
                        constraints=annotation.constraints,
                    )
                    expected.append((str(stream), world.is_below(term.name, carried.name)))
    found = match(Concept(term, ranges), annotations, world.knowledge())
    assert sorted((str(each.declaration.stream), each.exact) for each in found) == sorted(expected)


@given(WORLDS, st.lists(ANNOTATIONS, max_size=4), TERMS, RANGES)
def test_matches_are_in_order_and_in_the_stream_language(
    world: World, annotations: list[Annotation], term: FeatureTerm, ranges: tuple[Range, ...]
) -> None:
    found = match(Concept(term, ranges), annotations, world.knowledge())
    preferences = []
    for each in found:
        (declaration,) = parse_specification(each.specification).declarations
        assert declaration == each.declaration
        assert isinstance(declaration, StreamDeclaration)
        constraints = declaration.stream.constraints
        preferences.append(
            (not each.exact, constraints.sample_period or inf, constraints.max_delay or inf)
        )
    assert preferences == sorted(preferences)
    assert len({each.stream_name for each in found}) == len(found)
    assert match(Concept(term, ranges), annotations[::-1], world.knowledge()) == found


@given(WORLDS, st.lists(ANNOTATIONS, max_size=4), TERMS, RANGES)
def test_something_matches_or_something_is_nearest(
    world: World, annotations: list[Annotation], term: FeatureTerm, ranges: tuple[Range, ...]
) -> None:
    concept = Concept(term, ranges)
    if not match(concept, annotations, world.knowledge()):
        message = nearest(concept, annotations, world.knowledge())
        assert message.startswith(f'no stream carries {concept}')


@given(WORLDS, st.lists(ANNOTATIONS, max_size=4), st.sampled_from(FEATURES))
def test_without_arguments_a_concept_is_that_of_all_objects(
    world: World, annotations: list[Annotation], name: str
) -> None:
    everything = Concept(
        FeatureTerm(name, (FeatureArgument('x'), FeatureArgument('y'))),
        (Range('x', 'S0'), Range('y', 'S0')),
    )
    bare = replace(everything, feature=FeatureTerm(name), ranges=())
    knowledge = world.knowledge()
    assert match(bare, annotations, knowledge) == match(everything, annotations, knowledge)


CHANGES = st.lists(st.lists(ANNOTATIONS, max_size=4) | WORLDS, min_size=1, max_size=4)


@given(WORLDS, CHANGES, TERMS, RANGES)
def test_a_changed_index_is_equal_to_a_new_one(
    world: World,
    changes: list[list[Annotation] | World],
    term: FeatureTerm,
    ranges: tuple[Range, ...],
) -> None:
    concept, annotations = Concept(term, ranges), list[Annotation]()
    matcher = Matcher(world.knowledge())
    for change in changes:
        if isinstance(change, World):
            world = change
            matcher.set_knowledge(world.knowledge())
        else:
            annotations = change
            matcher.set_annotations({str(each): each for each in annotations})
        distinct = {str(each): each for each in annotations}.values()
        assert matcher.match(concept) == match(concept, distinct, world.knowledge())


def test_a_change_of_the_ontology_has_an_effect() -> None:
    world = World([('S1', 'S0')], {'a': 'S1', 'b': 'S1'})
    other = World([('F1', 'F0'), ('S1', 'S0')], {'a': 'S1'})
    ssl = """stream s contains F1[x, x] = p for every x in S1 where x = id;
             stream t contains F0[b, b] = p"""
    matcher = matcher_of(parse_annotations(ssl), world.knowledge())
    concept = parse_concept('F0')
    assert [each.ground_feature for each in matcher.match(concept)] == ['F0[b, b]']
    matcher.set_knowledge(other.knowledge())
    assert [each.ground_feature for each in matcher.match(concept)] == ['F0[a, a]']
    assert matcher.faults.keys() == {'stream t contains F0[b, b] = p;'}
    matcher.set_knowledge(world.knowledge())
    assert [each.ground_feature for each in matcher.match(concept)] == ['F0[b, b]']


def test_matches_and_near_misses_are_explained(knowledge: Knowledge) -> None:
    ssl = f"""{SSL} stream a contains Altitude[rover] = z [ft];
              stream b contains BarometricAltitude[uav2] = v;
              stream c contains Altitude[rovr] = z"""
    found = matcher_of(parse_annotations(ssl), knowledge).explain(
        parse_concept('vehicles:BarometricAltitude[uav1]')
    )
    assert [(each.stream, each.matches, each.reason) for each in found] == [
        (('stream vehicles_BarometricAltitude_uav1_from_barometer = '
         'select z as "vehicles:BarometricAltitude[uav1]" from barometer '
         'with sample_period = 10 ms'), True,
         'exact match: barometer carries vehicles:BarometricAltitude[uav1]'),
        ('b carries BarometricAltitude[uav2]', False,
         'it carries none of the objects that are asked for'),
        ('"/fleet" carries Altitude[u] for every u in UAV', False,
         'Altitude is above BarometricAltitude, not below it'),
        ('a carries Altitude[rover]', False, 'Altitude is above BarometricAltitude, not below it'),
        ('laser carries Height[uav2]', False, 'Height is above BarometricAltitude, not below it'),
        ('stream c contains Altitude[rovr] = z;', False,
         ("'rovr' is no variable (add: for every rovr in Vehicle) and no object: "
         "unknown instance 'rovr'; did you mean 'rover'?")),
    ]  # fmt: skip


def test_units_are_converted(knowledge: Knowledge) -> None:
    ssl = """stream "/fleet" contains Altitude[u] = z [ft], Power[uav1] = p [kW]
             for every u in UAV where u = id with max_delay = 100 ms"""
    assert '\n'.join(specifications('Altitude[uav2]', knowledge, ssl)) == (
        '# exact match: "/fleet" carries Altitude[uav2]; ft is converted to m\n'
        'compunit value: float convert(value: float);\n'
        'stream Altitude_uav2_from_fleet = select value as "Altitude[uav2]" from convert('
        'select z as value from "/fleet" where id = "uav2" with max_delay = 100 ms, '
        'given = "ft", wanted = "m");'
    )
    (power,) = specifications('Power', knowledge, ssl)
    assert 'given = "kW", wanted = "W"' in power


def test_another_spelling_of_the_unit_is_not_converted(knowledge: Knowledge) -> None:
    (found,) = specifications('Altitude', knowledge, 'stream a contains Altitude[uav1] = z [meter]')
    assert 'convert' not in found


def test_a_unit_that_does_not_convert_is_a_mismatch_with_the_reason(knowledge: Knowledge) -> None:
    ssl = 'stream a contains Altitude[uav1] = z [kg]'
    matcher = matcher_of(parse_annotations(ssl), knowledge)
    concept = parse_concept('Altitude[uav1]')
    assert matcher.match(concept) == ()
    reason = "feature 'Altitude' is measured in m, which kg does not convert to"
    assert [(each.stream, each.reason) for each in matcher.explain(concept)] == [
        (f'{ssl};', reason)
    ]
    assert matcher.nearest(concept).endswith(f'; the annotation of a is invalid: {reason}')


def test_a_converted_stream_of_many_objects_carries_the_object_that_was_asked_for(
    knowledge: Knowledge,
) -> None:
    ssl = """stream "/fleet" contains Altitude[u] = z [ft] for every u in UAV where u = id
             with max_delay = 2 s"""
    (specification,) = specifications('Altitude[uav2]', knowledge, ssl)
    made: list[Sample] = []
    broken: list[object] = []
    flow = Dataflow(load_units(), lambda _: None)
    parsed = parse_specification(specification)
    flow.create('s', parsed, NO_CONSTRAINTS, made.append, broken.append)
    second = 1_000_000_000
    # The second sample is late, within the delay that the annotation allows.
    samples = [(20, 'uav2', 2000.0), (19, 'uav1', 3000.0), (19, 'uav2', 1000.0), (30, 'uav2', 0.0)]
    for number, (valid, name, feet) in enumerate(samples):
        available = max(valid, 20) * second + number
        flow.push('/fleet', Sample(valid * second, available, {'id': name, 'z': feet}))
    flow.advance(40 * second)
    assert broken == []
    assert [(each.valid_time // second, dict(each.fields)) for each in made] == [
        (19, {'Altitude[uav2]': 304.8}),
        (20, {'Altitude[uav2]': 609.6}),
        (30, {'Altitude[uav2]': 0.0}),
    ]
