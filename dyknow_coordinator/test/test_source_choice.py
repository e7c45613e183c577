"""The choice among sources: preferences, failures and silence."""

from __future__ import annotations

import asyncio

import pytest

from dyknow_common import SECOND_NS, DyKnowError, ExitCode, Symbol, SymbolKind
from dyknow_coordinator import (
    Candidates,
    CandidateSearch,
    CoordinationError,
    FeatureSource,
    Grounding,
    KnownStream,
    KnownStreams,
    SourceChoice,
    StateFault,
    describe_violation,
    parse_sources,
    worst_fault,
)
from dyknow_coordinator.grounding import feature_sources
from dyknow_coordinator.grounding.completion import infer_sorts
from dyknow_coordinator.grounding.scopes import Scopes
from dyknow_coordinator.grounding.source_session import may_be_silent
from dyknow_reasoning.language.sugar import SPATIAL
from dyknow_stream_processing import Violation


def source(topic: str, constraints: str = '') -> FeatureSource:
    name = topic.strip('/')
    return FeatureSource('F', name, f'stream {name} = select x as F from "{topic}"{constraints}')


A, B, C = source('/a'), source('/b'), source('/c')
CANDIDATES = Candidates((A, B, C))
KNOWN = KnownStreams([], {'/b', '/c'}.__contains__)


def test_available_sources_come_first() -> None:
    choice = SourceChoice()
    assert choice.choose(['F'], CANDIDATES, KNOWN, 0) == (B,)
    everything = KnownStreams([], lambda _: True)
    assert choice.choose(['F'], CANDIDATES, everything, 0) == (A,)


def test_failed_sources_are_excluded_for_ten_seconds() -> None:
    choice = SourceChoice()
    choice.exclude([B], 0)
    assert choice.choose(['F'], CANDIDATES, KNOWN, 10 * SECOND_NS - 1) == (C,)
    assert choice.is_excluded(B, 10 * SECOND_NS - 1)
    assert choice.choose(['F'], CANDIDATES, KNOWN, 10 * SECOND_NS) == (B,)


def test_a_source_that_nobody_publishes_replaces_none() -> None:
    choice = SourceChoice()
    choice.exclude([B, C], 0)
    assert choice.choose(['F'], CANDIDATES, KNOWN, 1) == (B,)


def test_better_sources_have_samples() -> None:
    choice, everything = SourceChoice(), KnownStreams([], lambda _: True)
    assert choice.better([C], CANDIDATES, everything, 0) == (A,)
    waiting = KnownStreams([], lambda _: True, has_begun=lambda topic: topic != '/a')
    assert choice.better([C], CANDIDATES, waiting, 0) == (B,)
    # Its first samples may still be on their way.
    assert choice.better([A], CANDIDATES, waiting, 0) == (A,)
    for failed in (A, B), (C,):
        choice.exclude(failed, 0)
        assert choice.better([C], CANDIDATES, everything, 1) == (C,)
    assert choice.exclusion_end([A, C], 1) == 10 * SECOND_NS
    assert choice.exclusion_end([A], 10 * SECOND_NS) is None


def test_other_sources_of_another_feature_replace_none() -> None:
    """The silent topic was "replaced" by itself, when another feature had a better source."""
    choice, other = SourceChoice(), FeatureSource('G', 'g', 'stream g = select x as G from "/b"')
    gone = FeatureSource('G', 'gone', 'stream gone = select x as G from "/a"')
    assert not choice.can_replace([B], [B, other], KNOWN, 0)
    assert not choice.can_replace([B], [other], KNOWN, 0)
    assert choice.can_replace([B, gone], [C, other], KNOWN, 0)
    assert not choice.can_replace([B, other], [C, gone], KNOWN, 0)
    choice.exclude([other], 0)
    assert choice.can_replace([B], [C, other], KNOWN, 0)
    assert not choice.can_replace([B, gone], [C, other], KNOWN, 0)


def test_better_sources_wait_while_a_topic_may_be_silent() -> None:
    received = {'regular': 20 * SECOND_NS, 'other': 19 * SECOND_NS}
    assert not may_be_silent(received.values(), 20 * SECOND_NS, 5 * SECOND_NS)
    assert may_be_silent(received.values(), 21 * SECOND_NS, 5 * SECOND_NS)
    # A latched topic is not: nothing more is known of it later.
    assert may_be_silent([11 * SECOND_NS + 1], 21 * SECOND_NS, 5 * SECOND_NS)
    assert not may_be_silent([11 * SECOND_NS], 21 * SECOND_NS, 5 * SECOND_NS)


def test_replacements_must_be_available_and_well() -> None:
    choice = SourceChoice()
    assert choice.can_replace([B], [C], KNOWN, 0)
    assert not choice.can_replace([B], [B], KNOWN, 0)
    assert not choice.can_replace([B], [A], KNOWN, 0)
    choice.exclude([C], 0)
    assert not choice.can_replace([B], [C], KNOWN, 0)


def test_what_has_no_samples_replaces_only_if_nothing_else_does() -> None:
    def known(*silent: str) -> KnownStreams:
        streams = [KnownStream('s', topic='/c', waits_for='x' if '/c' in silent else '')]
        return KnownStreams(streams, lambda _: True, has_begun=lambda topic: topic not in silent)

    choice = SourceChoice()
    choice.exclude([A], 0)
    for silent, expected in (((), B), (('/b',), C), (('/b', '/c'), B)):
        assert choice.replacements(['F'], CANDIDATES, known(*silent), 1) == (expected,)
        assert choice.can_replace([A], [expected], known(*silent), 1) is (len(silent) < 2)
    assert choice.choose(['F'], CANDIDATES, known('/b'), 1) == (B,)


def test_stand_ins_avoid_the_sources_in_use() -> None:
    other = FeatureSource('G', 'g', 'stream g = select x as G from "/b"')
    candidates = Candidates((A, B, C, other))
    choice = SourceChoice()
    assert choice.stand_ins([B, other], candidates, KNOWN, 0) == (C, other)
    assert choice.stand_ins([C, other], candidates, KNOWN, 0) == (B, other)
    assert choice.stand_ins([other], candidates, KNOWN, 0) == ()
    assert choice.stand_ins([C], Candidates((A, C)), KNOWN, 0) == ()
    everything = KnownStreams([], lambda _: True)
    assert choice.stand_ins([B], CANDIDATES, everything, 0) == (A,)
    assert choice.stand_ins([B], CANDIDATES, everything, 0, [C]) == (C,)
    assert choice.stand_ins([C], CANDIDATES, everything, 0, [C]) == (A,)
    choice.exclude([C], 0)
    assert choice.stand_ins([B, other], candidates, KNOWN, 0) == ()
    assert choice.stand_ins([B, other], candidates, KNOWN, 10 * SECOND_NS) == (C, other)
    choice.exclude([other], 11 * SECOND_NS)
    assert choice.stand_ins([B, other], candidates, KNOWN, 11 * SECOND_NS) == ()


def test_the_worst_fault_is_one_of_the_streams_themselves() -> None:
    former, lost, broken = (
        StateFault(CoordinationError(''), transient=transient) for transient in (True, True, False)
    )
    assert worst_fault([broken, lost]) is broken
    assert worst_fault([former, lost]) is lost


def test_violations_are_described_with_what_was_measured() -> None:
    assert describe_violation(
        Violation('s', 'max_delay', 0, 0, 3 * SECOND_NS, SECOND_NS, 'late')
    ) == ('late (max_delay: 3 s observed, 1 s allowed)')
    early = Violation('s', 'max_gap', 0, 0, 0, SECOND_NS, 'early')
    assert describe_violation(early) == 'early (max_gap: 0 ns observed, 1 s allowed)'
    late = Violation('s', 'max_gap', 0, 0, SECOND_NS, 0, 'late')
    assert describe_violation(late) == 'late (max_gap: 1 s observed, 0 ns allowed)'
    absent = Violation('s', 'fields', 0, 0, 0, 0, 'no field x')
    assert describe_violation(absent) == 'no field x (fields)'


async def matching(concept: str) -> tuple[FeatureSource, ...]:
    if concept == 'Broken':
        raise CoordinationError('the matching engine is gone', ExitCode.UNAVAILABLE)
    if concept != 'Power[object1] for every object1 in UAV':
        raise CoordinationError(f'no stream carries {concept}', ExitCode.NOT_FOUND)
    return parse_sources(['stream p = select p as "Power[u1]" from "/p"'])


async def fields(name: str) -> tuple[str, ...]:
    if name != 'speed':
        code = ExitCode.UNAVAILABLE if name == 'hidden' else ExitCode.NOT_FOUND
        raise CoordinationError(f"there is no stream '{name}'", code)
    return ('v',)


def symbol(name: str, *arguments: str) -> Symbol:
    return Symbol(SymbolKind.FEATURE, name, arguments)


def test_the_search_for_candidates() -> None:
    search = CandidateSearch(matching, fields)
    symbols = [
        Symbol(SymbolKind.SORT, 'UAV'),
        symbol('Power', 'UAV'),
        symbol('speed'),
        symbol('other.x'),
        symbol('speed', 'u1'),
        symbol('height'),
    ]
    found = asyncio.run(search.find(symbols, Grounding.AUTO))
    assert [each.feature for each in found.found] == ['Power[u1]', 'speed', 'other.x']
    absent = ['speed[u1]', 'height']
    assert found.nearest == {each: f'no stream carries {each}' for each in absent}
    for name, reason in ('Broken', 'is gone'), ('hidden', "no stream 'hidden'"):
        with pytest.raises(DyKnowError, match=reason):
            asyncio.run(search.find([symbol(name)], Grounding.AUTO))
    for grounding, expected in (Grounding.SYNTACTIC, ['speed']), (Grounding.SEMANTIC, []):
        found = asyncio.run(search.find([symbol('speed')], grounding))
        assert [each.feature for each in found.found] == expected


def test_an_unknown_feature_is_the_only_fault() -> None:
    # People never saw the concept that was asked for, and what follows is no fault of its own.
    unknown = "concept:1:1: unknown concept 'Sped'; did you mean 'Speed'?\n  Sped[r1]\n  ^"
    with pytest.raises(CoordinationError) as error:
        Candidates((), {'Sped[r1]': unknown}).choose(['Sped[r1]'])
    assert error.value.message == "unknown concept 'Sped'; did you mean 'Speed'?"
    with pytest.raises(CoordinationError) as error:
        Candidates((), {'Speed[r1]': 'nearest: a'}).choose(['Speed[r1]'])
    assert error.value.message == 'no stream carries Speed[r1]; annotate one that does\nnearest: a'


def test_relations_of_positions_have_mends() -> None:
    relations = SPATIAL.keys() | {'swept_distance', 'yaw', 'sight_distance'}
    assert relations == feature_sources._MENDS.keys()
    unknown = "concept:1:1: unknown concept 'inside'\n  inside[a]\n  ^"
    with pytest.raises(CoordinationError) as error:
        Candidates((), {'inside[a]': unknown}).choose(['inside[a]'])
    mend = 'the relation is of two objects: inside(a, b)'
    assert error.value.message == f'no stream carries inside[a]; {mend}'


def test_sorts_are_inferred_from_a_query() -> None:
    async def query(sparql: str) -> list[tuple[str, ...]]:
        assert '#argument1>' in sparql
        return [('Power', 'UAV')]

    scopes = Scopes('forall u: (Power[u])')
    assert asyncio.run(infer_sorts(scopes, query)) == dict(
        zip(scopes.binders, ['UAV'], strict=True)
    )
