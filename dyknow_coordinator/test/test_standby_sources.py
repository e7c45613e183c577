"""The sources that stand by: better ones, others, and none that have failed."""

from __future__ import annotations

import pytest

from dyknow_common import SECOND_NS
from dyknow_coordinator import Candidates, FeatureSource, KnownStreams, StandbySources
from dyknow_coordinator.grounding.source_session import EXCLUSION_NS
from dyknow_stream_processing import Violation, ViolationKind


def source(topic: str) -> FeatureSource:
    return FeatureSource('F', topic, f'stream {topic} = select x as F from "/{topic}"')


A, B, C = source('a'), source('b'), source('c')


@pytest.fixture
def sources() -> StandbySources:
    """Return the sources that stand by for B; C does."""
    found = StandbySources(lambda: KnownStreams([], lambda _: True), Candidates((A, B, C)))
    found.in_use, found.chosen = (B,), (C,)
    return found


def violation(stream: str) -> Violation:
    return Violation(stream, ViolationKind.MAX_GAP, 0, 0, 2 * SECOND_NS, SECOND_NS, 'broken')


def test_better_sources_stand_by_to_replace_those_in_use(sources: StandbySources) -> None:
    assert sources.wanted(0) == (C,)
    assert sources.wanted(0, (B,)) == (C,)
    assert sources.wanted(0, (A,)) == (A,)
    sources.exclude((A,), 0)
    assert sources.wanted(1, (A,)) == (C,)
    assert sources.wanted(EXCLUSION_NS, (A,)) == (A,)


def test_what_no_stream_can_be_made_of_leaves_it_to_others(sources: StandbySources) -> None:
    sources.exclude_unusable((C,), 0)
    assert not sources.is_well(1)
    assert sources.wanted(1) == (A,)
    sources.exclude_unusable((A,), 1)
    assert sources.wanted(2) == ()
    assert sources.exclusion_end(2) == EXCLUSION_NS


@pytest.mark.parametrize(
    ('stream', 'is_own', 'is_well', 'wanted'),
    [
        ('/a', False, True, (C,)),
        ('/b', False, True, (C,)),
        ('/c', False, False, (A,)),
        ('/a', True, False, (A,)),
        ('states', True, False, (A,)),
        ('', False, False, (C,)),
    ],
)
def test_a_violation(
    sources: StandbySources,
    stream: str,
    is_own: bool,  # noqa: FBT001
    is_well: bool,  # noqa: FBT001
    wanted: tuple[FeatureSource, ...],
) -> None:
    assert sources.is_well(0)
    sources.note_violation(violation(stream), 0, is_own=is_own)
    assert sources.is_well(1) == is_well
    assert sources.wanted(1) == wanted
    assert sources.is_well(EXCLUSION_NS) == is_well
    sources.give_up()
    assert not sources.is_well(1)
    sources.chosen = wanted
    assert sources.is_well(1)


@pytest.mark.parametrize(
    ('published', 'begun', 'failed', 'is_well'),
    [
        ('ac', 'ac', 'b', True),
        ('a', 'ac', 'b', False),
        ('ac', 'a', 'b', False),
        ('ac', 'ac', 'a', False),
    ],
)
def test_all_sources_of_a_standby_must_be_well(
    published: str,
    begun: str,
    failed: str,
    is_well: bool,  # noqa: FBT001
) -> None:
    topics = [{f'/{each}' for each in letters}.__contains__ for letters in (published, begun)]
    known = KnownStreams([], topics[0], has_begun=topics[1])
    sources = StandbySources(lambda: known, Candidates(()))
    sources.chosen = (A, C)
    sources.exclude([source(failed)], 0)
    assert sources.is_well(1) == is_well
