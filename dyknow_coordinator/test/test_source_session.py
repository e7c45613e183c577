"""The sources at fault: of violations, of broken constraints of the states, and of silence."""

from __future__ import annotations

import pytest

from dyknow_common import NO_CONSTRAINTS, SECOND_NS, DyKnowError, ExitCode
from dyknow_coordinator import (
    Candidates,
    FeatureSource,
    FormulaInputs,
    Grounding,
    KnownStreams,
    SourceSession,
)
from dyknow_coordinator.grounding.source_session import REPORT_NS
from dyknow_stream_processing import Violation, ViolationKind

LIMIT = 5 * SECOND_NS


def source(topic: str, feature: str, constraints: str = '') -> FeatureSource:
    name = f'{feature}_{topic}'.lower()
    text = f'stream {name} = select x as {feature} from "/{topic}"{constraints}'
    return FeatureSource(feature, name, text)


A, B, G = source('a', 'F'), source('b', 'F'), source('g', 'G')


class World:
    """A session, and its streams; times are in seconds."""

    def __init__(
        self, *found: FeatureSource, published: str = 'abg', can_wait: bool = True
    ) -> None:
        self.excluded: list[FeatureSource] = []
        known = KnownStreams([], {f'/{each}' for each in published}.__contains__)
        inputs = FormulaInputs(
            (), Grounding.AUTO, ('F', 'G'), Candidates(found), {}, NO_CONSTRAINTS
        )
        self.session = SourceSession(inputs, lambda: known, can_wait=can_wait)
        self.session.standby.exclude = self._exclude  # type: ignore[method-assign]
        self.session.chosen = self.session.choose(inputs.candidates, 0)

    def _exclude(self, sources: object, _now: int) -> None:
        self.excluded += sources  # type: ignore[call-overload]

    def violate(
        self, stream_name: str, kind: ViolationKind = ViolationKind.MAX_GAP, now: int = 0
    ) -> None:
        violation = Violation(stream_name, kind, 0, 0, 2 * SECOND_NS, SECOND_NS, 'broken')
        self.session.note_violation(violation, 'states', self.session.chosen, now)

    def look(self, now: float, known_until: float | None = None, **received: float) -> list[str]:
        """Look for faults; topics are heard of at last when the session knows of them."""
        at = round(now * SECOND_NS)
        heard = {f'/{topic}': round(time * SECOND_NS) for topic, time in received.items()}
        until = at if known_until is None else round(known_until * SECOND_NS)
        self.session.look('states', heard, 0, at, known_until=until)
        return [each.error.message for each in self.session.faults]


@pytest.fixture
def world() -> World:
    return World(A, B, G)


def test_the_source_of_a_violation_is_replaced(world: World) -> None:
    world.violate('/a')
    (fault,) = world.session.faults
    assert not fault.transient
    assert fault.error.code is ExitCode.CONSTRAINT_VIOLATION
    assert world.excluded == [A]
    assert world.session.react(1) == (B, G)


def test_a_transient_violation_excludes_nothing(world: World) -> None:
    world.violate('/a', ViolationKind.LOST)
    assert [each.transient for each in world.session.faults] == [True]
    assert world.session.react(1) == (A, G)


def test_nothing_replaces_any_source_once_the_clock_was_set_back(world: World) -> None:
    """States of others have times of before, and are of another run."""
    world.violate('', ViolationKind.VALID_TIME_ORDER)
    assert world.session.react(1) is None


def test_a_violation_of_unknown_origin_excludes_all_sources(world: World) -> None:
    world.violate('/other')
    assert world.excluded == [A, G]


def test_the_source_that_makes_states_break_a_constraint_is_found_once(world: World) -> None:
    for now in range(2):
        world.violate('states', now=now)
    due = REPORT_NS / SECOND_NS
    assert world.look(due - 0.01, a=0.1, g=1.1) == []
    assert world.session.unexplained('states') is not None
    world.look(due, a=0.1, g=1.2)
    assert world.excluded == [A]
    (fault,) = world.session.faults
    assert fault.error.message == 'broken (max_gap: 2 s observed, 1 s allowed)'
    world.look(due + 1, a=0.1, g=2.2)
    assert world.session.faults == [fault]
    # It counts from now on.
    assert world.session.choice.have_failed([A, G], REPORT_NS + 10 * SECOND_NS - 1)
    assert not world.session.choice.have_failed([G], REPORT_NS)


def test_all_sources_are_excluded_if_no_topic_lags(world: World) -> None:
    world.violate('states')
    world.look(2, a=1.9, g=0.9)
    assert world.excluded == [A, G]


def test_the_constraint_of_a_stream_that_was_left_blames_nobody(world: World) -> None:
    world.violate('states')
    world.session.look('others', {}, 0, 3 * SECOND_NS, known_until=0)
    assert (world.excluded, world.session.faults) == ([], [])
    assert world.session.unexplained('states') is None


def test_silence_counts_until_what_is_known(world: World) -> None:
    assert world.look(9, known_until=6, a=1, g=8) == []
    assert world.look(9, known_until=6 + 1e-9, a=1, g=8) == ["topic '/a' has been silent for 5 s"]
    assert world.excluded == [A]


@pytest.mark.parametrize(('now', 'expected'), [(9, (A, G)), (12, (B, G))])
def test_better_sources_wait_for_what_may_be_silent(
    world: World, now: int, expected: tuple[FeatureSource, ...]
) -> None:
    world.session.chosen = (B, G)
    received = {'/b': 9 * SECOND_NS, '/g': 9 * SECOND_NS}
    assert world.session.better(received, now * SECOND_NS, 0) == expected


@pytest.mark.parametrize('found', [(A, G), (A, B, G)])
def test_a_silent_topic_without_another_is_kept(found: tuple[FeatureSource, ...]) -> None:
    world = World(*found, published='ag')
    assert world.look(9, a=1, g=8) == []
    received = {'/a': 9 * SECOND_NS, '/g': 9 * SECOND_NS}
    assert world.session.better(received, 9 * SECOND_NS, 9 * SECOND_NS) == (A, G)


def test_a_silent_topic_that_should_not_be_is_a_failure() -> None:
    periodic = source('a', 'F', ' with max_gap = 1 s')
    world = World(periodic, source('a', 'G'), published='a')
    assert world.look(9, a=0) == []  # It may never have a sample.
    world.look(9, a=1)
    assert world.session.failure().message == "topic '/a' has been silent for 5 s"
    assert world.session.react(9 * SECOND_NS) is None
    world.session.note_obstacle((periodic, G), DyKnowError('no engine'), 0)
    assert world.session.failure().message.endswith('5 s; no other states: no engine')


def test_replaced_sources_are_why_states_may_be_missing(world: World) -> None:
    world.violate('/a')
    assert world.session.react(1) == (B, G)
    world.violate('/g', ViolationKind.LOST)  # Meanwhile.
    event = world.session.note_replaced((B, G))
    assert event.startswith('broken (max_gap: 2 s observed, 1 s allowed); states are made of sele')
    assert world.session.cause.code is ExitCode.CONSTRAINT_VIOLATION
    assert [each.transient for each in world.session.faults] == [True]


@pytest.mark.parametrize('can_wait', [True, False])
def test_sources_that_no_stream_is_made_of_are_tried_again_if_that_may_help(
    *, can_wait: bool
) -> None:
    world = World(A, G, published='ag', can_wait=can_wait)
    world.violate('/a', ViolationKind.LOST)
    world.session.exclude([A], 1)
    assert world.session.react(1) == (A, G)
    world.session.note_obstacle((A, G), DyKnowError('no engine', ExitCode.UNAVAILABLE), 1)
    assert world.session.react(1) == ((A, G) if can_wait else None)
    world.violate('/a')
    assert world.session.react(1) is None
    assert world.session.react(1, standby=(B, G)) == (B, G)


@pytest.mark.parametrize(
    ('can_wait', 'code', 'tried', 'excluded'),
    [
        (True, ExitCode.UNAVAILABLE, (B, G), []),
        (True, ExitCode.NOT_FOUND, (B, G), [B]),
        (True, ExitCode.NOT_FOUND, (A, G), []),
        (False, ExitCode.UNAVAILABLE, (B, G), [B]),
        (False, ExitCode.NOT_FOUND, (A, G), [A, G]),
    ],
)
def test_sources_that_no_stream_is_made_of_are_excluded_unless_it_may_be_made_later(
    *,
    can_wait: bool,
    code: ExitCode,
    tried: tuple[FeatureSource, ...],
    excluded: list[FeatureSource],
) -> None:
    world = World(A, B, G, can_wait=can_wait)
    world.session.note_obstacle(tried, DyKnowError('no engine', code), 1)
    assert world.excluded == excluded
