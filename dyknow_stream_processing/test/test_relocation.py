"""Specifications that mean the same on every engine."""

import pytest

from dyknow_stream_processing import free_names, parse_specification
from dyknow_stream_processing.management.relocation import (
    aliases,
    with_absolute_topics,
    with_aliases,
    without,
)

EVERYTHING = """
source (v: float) battery;
compunit power: float electrical_power((voltage: float, current: float));
stream a = electrical_power(select voltage, current from "near" where v > 1.0) with max_delay = 1 s;
stream b = merge(battery, "/far", a, other) with sample_period = 1 s;
sink sync(b, ("near" with max_delay = 1 s))
"""


def test_topics_become_absolute_wherever_they_are() -> None:
    parsed = parse_specification(EVERYTHING)
    moved = with_absolute_topics(parsed, '/robot1')
    assert str(moved) == str(parsed).replace('"near"', '"/robot1/near"').replace(
        'float) battery', 'float) "/robot1/battery"'
    ).replace('merge(battery', 'merge("/robot1/battery"')
    assert parse_specification(str(moved)) == moved
    assert with_absolute_topics(moved, '/robot2') == moved
    assert free_names(moved).streams == {'other'}


def test_aliases_come_and_go() -> None:
    parsed = parse_specification(EVERYTHING)
    aliased = with_aliases(parsed, {'other': '/streams/other'})
    assert free_names(aliased).streams == frozenset()
    assert aliases(aliased) == {'other': '/streams/other'}
    assert without(aliased, aliases(aliased)) == parsed


@pytest.mark.parametrize(
    'text',
    [
        'stream a = "/t"',
        'stream a = "/t" with max_delay = 1 s; sink a',
        'stream a = select x from "/t"; sink a',
        'stream a = "/t"; sink "a"',
    ],
)
def test_what_is_no_alias(text: str) -> None:
    assert aliases(parse_specification(text)) == {}


def test_built_in_sources_keep_their_frames_and_get_absolute_actions() -> None:
    text = 'sync(tf("map", "base") with max_delay = 1 s, action("dock"), action("/go"))'
    moved = with_absolute_topics(parse_specification(text), '/robot1')
    assert str(moved) == f'sink {text}'.replace('"dock"', '"/robot1/dock"')
    assert free_names(moved).topics == {'/tf', '/robot1/dock/_action/status', '/go/_action/status'}


def test_the_messages_of_a_sink_stay() -> None:
    text = 'stream a = "/t";\nsink a as std_msgs/msg/Float64 (data = x)'
    for topic, moved in [('', ''), (' on "out"', ' on "/robot1/out"'), (' on "/o"', ' on "/o"')]:
        found = with_absolute_topics(parse_specification(text + topic), '/robot1')
        assert str(found) == text + moved
        assert aliases(found) == {'a': '/t'}
        assert str(without(found, {'a'})) == text.partition('\n')[2] + moved
