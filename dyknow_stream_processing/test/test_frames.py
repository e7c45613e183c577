"""Streams of the transform between two frames: times, faults, and what they wait for."""

from __future__ import annotations

import math
from types import SimpleNamespace

import pytest
from recorded_flow import Flow
from transform_messages import push, push_transforms, transform

from dyknow_common import ValueType
from dyknow_stream_processing import (
    StreamReference,
    Violation,
    ViolationKind,
    made,
    parse_specification,
)
from dyknow_stream_processing.dataflow.built_in import transform_tree

STRING = ValueType.STRING
QUARTER = (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))


def reasons(flow: Flow) -> list[str]:
    return list(flow.dataflow.waits_for('s', -1, lambda topic: f'no {topic}'))


def test_the_example_of_the_module(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    emitted = []
    for now, parent, child, at, x in [
        (10, 'odom', 'base', 10, 0.0),
        (15, 'map', 'odom', 15, 0.0),
        (20, 'odom', 'base', 20, 4.0),
        (30, 'odom', 'base', 30, 4.0),
        (31, 'map', 'odom', 30, 30.0),
    ]:
        push_transforms(flow, now, transform(parent, child, at, (x, 0.0, 0.0)))
        emitted.append([(time, fields['translation.x']) for time, fields in flow.take()])
    assert emitted == [[], [], [(15, 2.0)], [], [(20, 14.0), (30, 34.0)]]
    assert flow.drops == {}


def test_all_fields(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    push_transforms(flow, 1, transform('map', 'base', 1, (3.0, 4.0, 0.0), QUARTER))
    ((_, fields),) = flow.take()
    assert fields == pytest.approx(
        {
            'translation.x': 3,
            'translation.y': 4,
            'translation.z': 0,
            'rotation.x': 0,
            'rotation.y': 0,
            'rotation.z': math.sqrt(0.5),
            'rotation.w': math.sqrt(0.5),
            'yaw': math.pi / 2,
            'distance': 5,
        }
    )


def test_the_other_direction(flow: Flow) -> None:
    flow.create('select translation.x, translation.y, yaw from tf("base", "map")')
    push_transforms(flow, 1, transform('map', 'base', 1, (3.0, 4.0, 0.0), QUARTER))
    ((_, fields),) = flow.take()
    assert fields == pytest.approx({'translation.x': -4, 'translation.y': 3, 'yaw': -math.pi / 2})


def test_static_links_give_one_sample_and_one_more_after_a_change(flow: Flow) -> None:
    flow.create('select distance from tf("base", "laser")')
    for now, distance in [(5, 1.0), (9, 1.0), (12, 2.0)]:
        link = transform('base', 'laser', 0, (distance, 0.0, 0.0))
        push_transforms(flow, now, link, static=True)
    assert flow.take() == [(5, {'distance': 1.0}), (12, {'distance': 2.0})]
    assert reasons(flow) == []


def test_a_sync_does_not_wait_for_static_links(flow: Flow) -> None:
    flow.create('sync((select distance from tf("base", "laser")), "a")')
    push_transforms(flow, 5, transform('base', 'laser', 0), static=True)
    flow.push('a', 7, x=1)
    assert flow.times() == []
    flow.advance(8)
    assert flow.times() == [7]


def test_a_later_stream_of_static_links_needs_no_further_message(flow: Flow) -> None:
    flow.create('tf("base", "laser")', name='first')
    push_transforms(flow, 5, transform('base', 'laser', 0), static=True)
    flow.take()
    flow.create('tf("laser", "base")')
    flow.advance(6)
    assert len(flow.take()) == 1


def test_a_later_stream_begins_with_later_transforms(flow: Flow) -> None:
    flow.create('tf("map", "base")', name='first')
    push_transforms(flow, 5, transform('map', 'base', 5))
    flow.take()
    flow.create('tf("base", "map")')
    flow.advance(6)
    assert flow.times() == []
    push_transforms(flow, 7, transform('map', 'base', 7))
    assert flow.times() == [7, 7]


def test_constraints_hold_as_for_topics(flow: Flow) -> None:
    flow.create('tf("map", "base") with max_delay = 10 ms, sample_period = 5 ms')
    push_transforms(flow, 6, transform('map', 'base', 5))
    push_transforms(flow, 21, transform('map', 'base', 10))
    assert flow.broken() == [('sample_period', 10), ('max_delay', 10)]
    flow.take()
    push_transforms(flow, 22, transform('map', 'base', 200))
    assert flow.broken() == [('future', 200)]


def test_a_late_transform_is_a_violation_by_default(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    push_transforms(flow, 5000, transform('map', 'base', 4000))
    push_transforms(flow, 5000, transform('map', 'base', 4001))
    assert (flow.times(), flow.broken()) == ([4000, 4001], [])
    push_transforms(flow, 6000, transform('map', 'base', 4999))
    (violation,) = flow.violations
    assert (violation.observed, violation.allowed) == (1_001_000_000, 1_000_000_000)
    assert 'came 1.00 s after its stamp; without a max_delay at most 1 s' in violation.message
    assert (flow.times(), flow.broken()) == ([], [('max_delay', 4999)])
    assert flow.drops == {'max_delay': 1}


def test_the_first_transform_may_be_late_already(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    push_transforms(flow, 5000, transform('map', 'base', 0.001))
    assert (flow.times(), flow.broken()) == ([], [('max_delay', 0.001)])


def test_a_slow_link_makes_samples_late(flow: Flow) -> None:
    text = 'tf("map", "base")'
    flow.create(text).create(f'{text} with max_delay = 2 s', 'stated')
    other = Flow().create(f'select distance from {text} with max_delay = 3 s')
    for each in (flow, other):
        push_transforms(each, 1000, transform('map', 'odom', 1000))
        for now in (1000, 1500, 2000, 2500):
            push_transforms(each, now, transform('odom', 'base', now))
        push_transforms(each, 2600, transform('map', 'odom', 2600))
    assert flow.broken() == [('max_delay', 1500)], 'The stream with a max_delay reports none.'
    other.advance(9000)
    assert (other.times(), other.broken()) == ([1000, 1500, 2000, 2500], [])


def test_transforms_are_not_late_for_a_link_that_was_missing(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    for now in (2000, 3000, 4000):
        push_transforms(flow, now, transform('odom', 'base', now))
    push_transforms(flow, 5500, transform('map', 'odom', 5500), static=True)
    assert (flow.times(), flow.broken()) == ([2000, 3000, 4000], [])
    push_transforms(flow, 7000, transform('odom', 'base', 5900))
    assert (flow.times(), flow.broken()) == ([], [('max_delay', 5900)])


def test_static_transforms_are_never_late(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    push_transforms(flow, 90_000, transform('map', 'base', 1), static=True)
    assert (flow.times(), flow.broken()) == ([90_000], [])


def test_a_transform_of_the_future_is_used_if_the_others_are_not(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    push_transforms(flow, 1, transform('map', 'odom', 1), transform('map', 'odom', 1000))
    push_transforms(flow, 500, transform('odom', 'base', 500))
    assert (flow.times(), flow.broken()) == ([500], [])


@pytest.mark.parametrize(
    ('pushed', 'reason'),
    [
        ([], 'no /tf'),
        (
            [('map', 'base_link')],
            "no frame 'base_lnk' in /tf or /tf_static; did you mean 'base_link'?",
        ),
        (
            [('map', 'odom'), ('foot', 'base_lnk')],
            "the frames 'map' and 'base_lnk' have no common parent: map, foot <- base_lnk",
        ),
        (
            [(f'f{number}', f'f{number + 1}') for number in range(9)] + [('f9', 'base_lnk')],
            "no frame 'map' in /tf or /tf_static",
        ),
        (
            [('map', 'x')]
            + [(f'f{number}', f'f{number + 1}') for number in range(9)]
            + [('f9', 'base_lnk')],
            (
                "the frames 'map' and 'base_lnk' have no common parent: "
                'map, f0 <- f1 <- f2 <- ... <- f9 <- base_lnk'
            ),
        ),
    ],
)
def test_what_is_missing_is_named(flow: Flow, pushed: list[tuple[str, str]], reason: str) -> None:
    flow.create('tf("map", "base_lnk")')
    for parent, child in pushed:
        push_transforms(flow, 1, transform(parent, child, 1))
    assert reasons(flow) == [reason]


def test_the_link_that_lags_is_named(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    push_transforms(flow, 1, transform('map', 'odom', 1), transform('odom', 'base', 1))
    push_transforms(flow, 9, transform('odom', 'base', 9))
    assert reasons(flow) == ["no transform of 'odom' in 'map' comes after the one valid at 0.001 s"]


@pytest.mark.parametrize(
    ('bad', 'reason', 'message'),
    [
        (
            transform('map', 'base', 5, rotation=(0.0, 0.0, 0.0, 2.0)),
            'transform',
            'its rotation is not normalised: its length is 2',
        ),
        (
            transform('map', 'base', 5, rotation=(0.0, 0.0, 0.0, 1e200)),
            'transform',
            'its rotation is not normalised: its length is inf',
        ),
        (
            transform('map', 'base', 5, (math.nan, 0.0, 0.0)),
            'transform',
            'it has a number that is not finite',
        ),
        (transform('map', 'base', 0), 'transform', 'it has no stamp'),
        (
            transform('map', 'base', 20_005),
            'future',
            'it is stamped 20 s ahead of the clock',
        ),
        (transform('', 'base', 5), 'transform', 'it names no parent or no child frame'),
        (transform('base', 'base', 5), 'loop', 'the frames would form a loop'),
        (transform('arm', 'base', 5), 'loop', 'the frames would form a loop'),
    ],
)
def test_bad_transforms_are_dropped(flow: Flow, bad: object, reason: str, message: str) -> None:
    flow.create('tf("map", "base")')
    push_transforms(flow, 4, transform('map', 'base', 4), transform('base', 'arm', 4))
    push_transforms(flow, 5, bad)
    assert (flow.times(), flow.drops) == ([4], {reason: 1})
    (violation,) = flow.violations
    assert violation.message == f"stream 's': a transform of 'base' cannot be used: {message}"


def test_a_refused_transform_is_the_reason_why_there_is_no_frame(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    push_transforms(flow, 1, transform('map', 'odom', 1))
    push_transforms(flow, 2, transform('map', 'base', 0))
    assert reasons(flow) == [
        "no frame 'base' in /tf or /tf_static; a transform of 'base' is refused: it has no stamp"
    ]


def test_bad_transforms_of_other_frames_are_no_violations(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    push_transforms(flow, 5, transform('x', 'x', 5), transform('map', 'base', 5))
    assert (flow.times(), flow.broken(), flow.drops) == ([5], [], {'loop': 1})


def test_a_rotation_is_normalised(flow: Flow) -> None:
    flow.create('select rotation.w from tf("map", "base")')
    push_transforms(flow, 5, transform('map', 'base', 5, rotation=(0.0, 0.0, 0.0, -1.004)))
    assert flow.take() == [(5, {'rotation.w': 1.0})]


def test_before_the_first_step_of_simulated_time(flow: Flow) -> None:
    flow.create('tf("map", "base") with max_lead = 1 min')
    push_transforms(flow, 0, transform('odom', 'base', 20_000))
    push_transforms(flow, 0, transform('map', 'odom', 0), static=True)
    assert (flow.times(), flow.broken(), flow.drops) == ([20_000], [], {})


def test_a_second_transform_of_one_time_is_dropped(flow: Flow) -> None:
    flow.create('select translation.x from tf("map", "base")')
    for x in (1.0, 2.0):
        push_transforms(flow, 5, transform('map', 'base', 5, (x, 0.0, 0.0)))
    assert flow.take() == [(5, {'translation.x': 1.0})]
    assert (flow.broken(), flow.drops) == ([], {'superseded': 1})


def test_a_jump_back_is_a_violation(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    for at in (20_000, 50):
        push_transforms(flow, 20_001, transform('map', 'base', at))
    assert (flow.times(), flow.broken()) == ([20_000], [('valid_time_order', 50)])
    assert flow.drops == {'valid_time_order': 1}


def test_a_late_transform_is_used_where_no_sample_was_made(flow: Flow) -> None:
    flow.create('select translation.x from tf("map", "base")')
    push_transforms(flow, 1, transform('map', 'odom', 1), transform('odom', 'base', 1))
    push_transforms(flow, 30, transform('odom', 'base', 30))
    push_transforms(flow, 31, transform('odom', 'base', 20, (5.0, 0.0, 0.0)))
    push_transforms(flow, 32, transform('map', 'odom', 25))
    assert flow.take() == [
        (1, {'translation.x': 0}),
        (20, {'translation.x': 5}),
        (25, {'translation.x': 2.5}),
    ]
    assert flow.drops == {}


def test_forgotten_transforms_are_violations(flow: Flow, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transform_tree, 'MAX_TRANSFORMS', 3)
    flow.create('tf("map", "base")')
    push_transforms(flow, 1, transform('map', 'odom', 1))
    for at in (1, 2, 3, 4, 5):
        push_transforms(flow, at, transform('odom', 'base', at))
    assert (flow.times(), flow.broken()) == ([1], [('buffer', 2)])
    push_transforms(flow, 6, transform('map', 'odom', 5))
    assert flow.times() == [3, 4, 5]


def test_transforms_are_kept_for_ten_seconds(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    push_transforms(flow, 1, transform('map', 'odom', 1))
    for at in (1, 2, 3, 10_003):
        push_transforms(flow, at, transform('odom', 'base', at))
    assert flow.broken() == [('buffer', 2)]


def test_the_number_of_frames_is_bounded(flow: Flow, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(transform_tree, 'MAX_FRAMES', 3)
    flow.create('tf("f0", "f4")')
    for number in range(4):
        push_transforms(flow, 1, transform(f'f{number}', f'f{number + 1}', 1))
    assert flow.drops == {'buffer': 1}
    assert reasons(flow) == [
        (
            "no frame 'f4' in /tf or /tf_static; "
            "a transform of 'f4' is refused: there are more than 3 frames"
        )
    ]


def test_a_deep_tree(flow: Flow) -> None:
    flow.create('select distance from tf("f0", "f999")')
    links = [transform(f'f{number}', f'f{number + 1}', 1, (1.0, 0.0, 0.0)) for number in range(999)]
    push_transforms(flow, 1, *links)
    assert flow.take() == [(1, {'distance': 999})]


def test_another_parent_begins_a_link_anew(flow: Flow) -> None:
    flow.create('select translation.x from tf("map", "box")')
    push_transforms(flow, 1, transform('map', 'hand', 1, (9.0, 0.0, 0.0)), static=True)
    push_transforms(flow, 2, transform('map', 'box', 2, (1.0, 0.0, 0.0)))
    push_transforms(flow, 4, transform('hand', 'box', 4, (1.0, 0.0, 0.0)))
    assert flow.take() == [(2, {'translation.x': 1.0}), (4, {'translation.x': 10.0})]
    assert (flow.broken(), flow.drops) == ([], {'parent_changed': 1})


def test_a_static_link_that_becomes_dynamic(flow: Flow) -> None:
    flow.create('tf("map", "box")')
    push_transforms(flow, 1, transform('map', 'box', 1), static=True)
    push_transforms(flow, 5, transform('map', 'box', 5))
    push_transforms(flow, 9, transform('map', 'box', 9), static=True)
    assert (flow.times(), flow.drops) == ([1, 5, 9], {'parent_changed': 1})


def test_a_leading_slash_is_ignored(flow: Flow) -> None:
    flow.create('tf("/map", "base")')
    push_transforms(flow, 1, transform('map', '/base', 1))
    assert flow.times() == [1]


def test_a_clock_that_is_set_back_begins_anew(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    push_transforms(flow, 50, transform('map', 'base', 50))
    kind = ViolationKind.VALID_TIME_ORDER
    flow.dataflow.restart(Violation('', kind, 0, 0, 0, 0, 'set back'))
    push_transforms(flow, 1, transform('map', 'base', 1))
    assert (flow.times(), flow.broken()) == ([50, 1], [(kind, 0)])


def test_other_messages_on_the_topic(flow: Flow) -> None:
    flow.create('tf("map", "base")')
    push(flow, '/tf', 1, SimpleNamespace(data=1))
    flow.push('/tf', 2, data=1)
    assert flow.broken() == [('fields', 1), ('fields', 2)]


def test_the_tree_is_shared(flow: Flow) -> None:
    for number in range(3):
        flow.create(f'tf("map", "base{number}")', name=f's{number}')
    assert dict(flow.dataflow.sources()) == {'/tf': {'**'}, '/tf_static': {'**'}}
    assert len(flow.dataflow._graph.sources['/tf']) == 1
    for number in range(3):
        flow.dataflow.destroy(f's{number}')
    assert flow.dataflow._graph.sources == {}


def test_the_tree_is_shared_with_streams_from_before_the_type_was_known(flow: Flow) -> None:
    flow.create('tf("base", "laser")', name='first')
    flow.receipt_topics |= {'/tf', '/tf_static'}
    flow.types = {name: {'transforms[0..].child_frame_id': STRING} for name in flow.receipt_topics}
    push_transforms(flow, 5, transform('base', 'laser', 0), static=True)
    flow.take()
    flow.create('tf("laser", "base")')
    flow.advance(6)
    assert len(flow.take()) == 1


def test_origins_are_the_topic_that_must_be_there() -> None:
    term = made(parse_specification('select yaw from tf("map", "base") with max_delay = 1 s'))
    assert [each.inputs for each in term.inputs] == [(StreamReference('/tf', is_topic=True),)]


def test_the_words_are_names_elsewhere(flow: Flow) -> None:
    flow.types = {'/a': {'tf': ValueType.INT, 'action': ValueType.INT}}
    flow.create('stream tf = select tf, action as yaw from "/a"; stream action = tf; sink action')
    flow.push('/a', 1, tf=1, action=2)
    assert flow.take() == [(1, {'tf': 1, 'yaw': 2})]
