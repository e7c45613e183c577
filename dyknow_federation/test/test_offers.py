"""A host offers the ground features that it shares and carries itself, and nothing else."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from dyknow_common import InlineText
from dyknow_configuration import read_robot
from dyknow_federation.meaning import imports
from dyknow_federation.messages import SharedFeature, SharedObject
from dyknow_federation.offers import Offer, offers, shares
from dyknow_semantics import Knowledge, Matcher, Ontology, parse_annotations, parse_concept
from dyknow_stream_processing import parse_specification

IMPORTED = '/dyknow/federation/'
ROBOT = """\
sorts: {Vehicle: , Rover: {below: Vehicle}}
objects: {Rover: [r1, r2]}
features:
  Charge:
    of: {r: Rover}
    unit: V
    from:
      - {topic: '/{r}/battery', field: v, unit: mV, max_gap: 1 s}
      - {topic: '/{r}/spare', field: v}
  Distance:
    of: {a: Rover, b: Rover}
    from: {topic: /distances, field: d, where: {a: first, b: second}}
  Ready: {type: boolean, from: {stream: state, field: ready}}
annotations: remote.ssl
"""
REMOTE = f'stream "{IMPORTED}p/Charge_r2" contains Charge[r2] = value with sample_period = 1 ms'


@pytest.fixture
def robot(tmp_path: Path) -> Iterator[tuple[Knowledge, Matcher]]:
    path = tmp_path / 'robot.yaml'
    path.write_text(ROBOT)
    (tmp_path / 'remote.ssl').write_text(REMOTE)
    found = read_robot(path)
    with closing(Ontology()) as ontology:
        for each in found.ontologies:
            assert isinstance(each, InlineText)
            ontology.load_text(each.text)
        texts = [
            each.text if isinstance(each, InlineText) else REMOTE for each in found.annotations
        ]
        annotations = {str(each): each for text in texts for each in parse_annotations(text)}
        matcher = Matcher(ontology.knowledge)
        matcher.set_annotations(annotations, {})
        yield ontology.knowledge, matcher


DEADBANDS = {'Charge': 0.5, 'Distance': 0.0, 'Ready': None}


def offered(robot: tuple[Knowledge, Matcher], *features: str) -> list[Offer]:
    knowledge, matcher = robot
    return [
        offer
        for name in features
        for offer in offers(
            knowledge.feature(name),
            [each.specification for each in matcher.match(parse_concept(name), 1000)],
            IMPORTED,
        )
    ]


def test_each_ground_feature_is_a_stream(robot: tuple[Knowledge, Matcher]) -> None:
    given, by_name = shares(3, offered(robot, 'Charge', 'Distance', 'Ready'), robot[0], DEADBANDS)
    pairs = [f'Distance_{a}_{b}' for a in ('r1', 'r2') for b in ('r1', 'r2')]
    assert [*by_name] == ['Charge_r1', 'Charge_r2', *pairs, 'Ready']
    assert given.version == 3
    assert given.objects == tuple(SharedObject(name, ('Rover', 'Vehicle')) for name in ('r1', 'r2'))
    charge = given.features[0]
    assert charge == SharedFeature('Charge', ('r1',), 'Charge_r1', 'float', 'V', 0.5)
    assert given.features[-1] == SharedFeature('Ready', (), 'Ready', 'boolean')


def test_the_specification_is_that_of_the_best_own_stream(
    robot: tuple[Knowledge, Matcher],
) -> None:
    """A stream of a peer is not offered again, though it is the best."""
    texts = {str(each.ground): each.specification for each in offered(robot, 'Charge')}
    assert '"/r2/battery"' in texts['Charge[r2]']
    assert 'as value' in texts['Charge[r2]']
    assert all(parse_specification(each) for each in texts.values())
    assert IMPORTED not in ''.join(texts.values())


def test_nothing_is_lost_on_the_way(robot: tuple[Knowledge, Matcher]) -> None:
    """What one host offers, another one can use."""
    given, by_name = shares(1, offered(robot, 'Charge', 'Distance', 'Ready'), robot[0], DEADBANDS)
    found = imports({'p': given}, (), (), lambda peer, stream: f'{IMPORTED}{peer}/{stream}')
    assert not found.faults
    assert {stream for _, stream in found.streams} == {*by_name}
    assert found.objects == dict.fromkeys(('r1', 'r2'), ('Rover', 'Vehicle'))
    assert found.streams['p', 'Ready'].sorts == ()
