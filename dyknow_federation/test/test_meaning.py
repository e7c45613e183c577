"""What peers share means here what it means there, and takes the place of no own name."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_federation.meaning import imports, missing_features
from dyknow_federation.messages import SharedFeature, SharedObject, Shares
from dyknow_semantics import parse_annotations

OBJECTS = ('a', 'b', 'part')
PEERS = ('p', 'q', 'r')

names = st.sampled_from(OBJECTS)
shares = st.dictionaries(
    st.sampled_from(PEERS),
    st.lists(names, unique=True, max_size=3).map(lambda found: shared(*found)),
)


def topic(peer: str, stream: str) -> str:
    return f'/dyknow/federation/{peer}/{stream}'


def feature(name: str) -> SharedFeature:
    return SharedFeature('Charge', (name,), f'Charge_{name}', 'float', 'V')


def shared(*objects: str) -> Shares:
    found = tuple(SharedObject(each, ('Robot',)) for each in objects)
    return Shares(1, found, tuple(map(feature, objects)))


def argument(annotation: str) -> str:
    (parsed,) = parse_annotations(annotation)
    return parsed.contents[0].feature.arguments[0].name


@given(shares, st.sets(names), st.sets(names), st.sets(st.sampled_from(('a', 'p_a', 'q_part'))))
def test_names_mean_one_thing(
    given_: dict[str, Shares], own: set[str], same: set[str], former: set[str]
) -> None:
    """Two streams are about one object only if a user has said so, or if no other has its name."""
    found = imports(given_, own, same, topic, former)
    assert not found.faults
    meant: dict[str, set[tuple[str, str]]] = {name: {('', name)} for name in own}
    for (peer, stream), each in found.streams.items():
        original = stream.removeprefix('Charge_')
        meant.setdefault(argument(each.annotation), set()).add((peer, original))
    for name, things in meant.items():
        assert len(things) == 1 or {original for _, original in things} == {name} <= same
    used = {argument(each.annotation) for each in found.streams.values()}
    assert used - own <= {*found.objects} <= used


def test_a_qualified_object_keeps_its_name_when_the_other_one_leaves() -> None:
    """Formulas that name it go on; a peer that shares an object of that very name takes it."""
    joined = imports({'p': shared('part'), 'q': shared('part')}, (), (), topic)
    left = imports({'p': shared('part')}, (), (), topic, joined.objects)
    assert left.objects == {'p_part': ('Robot',)}
    assert argument(left.streams['p', 'Charge_part'].annotation) == 'p_part'
    taken = imports({'p': shared('part'), 'r': shared('p_part')}, (), (), topic, joined.objects)
    assert {*taken.objects} == {'part', 'p_part'}


def test_qualified_names_that_meet_are_no_one_thing() -> None:
    given_ = {'p': shared('a_b'), 'p_a': shared('b'), 'q': shared('a_b', 'b')}
    found = imports(given_, (), (), topic)
    assert {*found.objects} == {'p_a_b', 'q_a_b', 'q_b'}
    assert [*found.streams] == [('p', 'Charge_a_b'), ('q', 'Charge_a_b'), ('q', 'Charge_b')]
    assert found.faults[0] == "peer 'p_a' shares 'b', but 'p_a_b' exists, too"


def test_a_stream_of_a_peer_is_a_topic_here() -> None:
    found = imports({'p': shared('a')}, (), (), topic)
    assert found.objects == {'a': ('Robot',)}
    assert found.streams['p', 'Charge_a'].annotation == (
        'stream "/dyknow/federation/p/Charge_a" contains Charge[a] = value [V];'
    )


@pytest.mark.parametrize(
    ('change', 'fault'),
    [
        ({'stream': 'a/b'}, 'cannot be a name here'),
        ({'name': 'Charge[a] = x; stream "b" contains B'}, 'cannot be a name here'),
        ({'unit': 'V]; stream "b" contains Charge[a] = value [V'}, 'is no unit'),
        ({'unit': 'V] with max_gap = 1 s; #'}, 'is no unit'),
        ({'unit': ']'}, 'expected'),
        ({'unit': 'V' * 1000}, 'more than 1,000'),
        ({'objects': ('c',)}, "'c' is not shared"),
    ],
)
def test_what_cannot_be_used_is_left_out(change: dict[str, Any], fault: str) -> None:
    given_ = replace(shared('a'), features=(replace(feature('a'), **change),))
    found = imports({'p': given_}, (), (), topic)
    assert not found.streams
    assert fault in found.faults[0]
    assert "peer 'p'" in found.faults[0]


def test_peers_that_share_one_sensor_are_alternatives() -> None:
    """Their streams carry one feature of one object, among which matching chooses."""
    wind = SharedFeature('Wind', (), 'Wind', 'float')
    given_ = {each: replace(shared('part'), features=(feature('part'), wind)) for each in 'pq'}
    found = imports(given_, (), ('part',), topic)
    carried = sorted(each.annotation.partition(' contains ')[2] for each in found.streams.values())
    charge = 'Charge[part] = value [V];'
    assert carried == [charge, charge, 'Wind = value;', 'Wind = value;']
    assert found.objects == {'part': ('Robot',)}
    assert not found.faults


@pytest.mark.parametrize('name', ['a b', '1a', 'a"; x', ''])
def test_objects_must_have_names(name: str) -> None:
    given_ = Shares(1, (SharedObject(name, ('Robot',)), SharedObject('a', ())))
    found = imports({'p': given_}, (), (), topic)
    assert not found.objects
    assert len(found.faults) == 2


def test_unknown_features_have_the_sorts_of_their_objects() -> None:
    objects = (SharedObject('a', ('Rover',)), SharedObject('b', ('Arm',)))
    given_ = Shares(1, objects, (feature('a'), feature('b')))
    streams = imports({'p': given_}, (), (), topic).streams
    ((missing, sorts),) = missing_features(list(streams.values()), ['Power'])
    assert missing.name == 'Charge'
    assert sorts == ['Object']
    ((_, sorts),) = missing_features([streams['p', 'Charge_a']], ['Power'])
    assert sorts == ['Rover']
    assert not list(missing_features(list(streams.values()), ['Charge']))
