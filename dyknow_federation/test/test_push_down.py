"""Parts of formulas that peers evaluate: the verdict is that of the whole formula."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import SECOND_NS, Verdict
from dyknow_coordinator import PEER_VERDICT, with_reasons_of_peers, with_waits_of_peers
from dyknow_federation.encoding import MAX_LENGTH
from dyknow_federation.errors import FederationError
from dyknow_federation.push_down import (
    MAX_NODES,
    PRESUMABLY_FALSE,
    UNDECIDED,
    PeerPart,
    PushDown,
    streams_of,
    verdict_text,
    with_prefix,
)
from dyknow_reasoning import Feature, FormulaGroup, parse_formula, walk

UNKNOWN = Verdict.UNDECIDED
DOMAINS = {'Robot': ('r1', 'r2', 'r3')}
PEERS = ('r1', 'r2')
"""Each is a peer with the streams of its features; `r3` is this host."""

STREAMS = {
    f'{feature}[{peer}]': (peer, f'{feature}_{peer}') for peer in PEERS for feature in ('P', 'X')
}
FEATURES = [f'{feature}[{robot}]' for robot in DOMAINS['Robot'] for feature in ('P', 'X')]

VERDICT = f'/dyknow/federation/r1/{PEER_VERDICT}1f_1'


def verdict_topic(part: PeerPart, number: int) -> str:
    return f'/dyknow/federation/{part.peer}/{PEER_VERDICT}1f_{number}'


def verdicts(
    formula: str, domains: Mapping[str, Sequence[str]], states: Sequence[Mapping[str, Any]]
) -> list[tuple[Verdict, bool]]:
    """The verdict on a formula after each state, and whether it is presumably false."""
    group = FormulaGroup()
    number = group.add_formula('', formula)
    group.begin(domains)
    found, verdict = [], UNKNOWN
    for result in group.decided_at_once():
        verdict = result.verdict
    for time, state in enumerate(states):
        for result in group.progress(time * SECOND_NS, state):
            assert result.formula_id == number
            verdict = result.verdict
        found.append((verdict, verdict is UNKNOWN and group.presumably_false(number)))
    return found


def text_of(robots: Sequence[str]) -> st.SearchStrategy[str]:
    """Formulas about some robots."""
    atoms = st.one_of(
        st.sampled_from([f'P[{robot}]' for robot in robots]),
        st.builds(
            lambda robot, limit: f'X[{robot}] > {limit}',
            st.sampled_from(robots),
            st.integers(0, 3),
        ),
    )
    windows = st.sampled_from(['', '[0 s, 2 s]', '[1 s, 3 s]'])
    return st.recursive(
        atoms,
        lambda inner: st.one_of(
            st.builds('not ({})'.format, inner),
            st.builds('({}) and ({})'.format, inner, inner),
            st.builds('({}) or ({})'.format, inner, inner),
            st.builds('({}) -> ({})'.format, inner, inner),
            st.builds('({}) <-> ({})'.format, inner, inner),
            st.builds('always{} ({})'.format, windows, inner),
            st.builds('eventually{} ({})'.format, windows, inner),
            st.builds('({1}) until{0} ({2})'.format, windows, inner, inner),
            st.builds('once{} ({})'.format, windows, inner),
        ),
        max_leaves=5,
    )


QUANTIFIED = st.builds(
    str.format,
    st.sampled_from(
        [
            'forall x in Robot: ({})',
            'exists x in Robot: ({})',
            'at least 2 x in Robot: ({})',
            'forall x in Robot: (x = r2 or {})',
            'forall x in Robot: exists z in Robot: x != z and ({})',
            'exists z in Robot: forall x in Robot: x = z -> ({})',
        ]
    ),
    st.one_of(text_of(['x']), text_of(['x', 'r1'])),
)

FORMULAS = st.recursive(
    st.one_of(text_of(['r1', 'r2', 'r3']), text_of(['r1']), text_of(['r2']), QUANTIFIED),
    lambda inner: st.one_of(
        st.builds('({}) and ({})'.format, inner, inner),
        st.builds('({}) or ({})'.format, inner, inner),
        st.builds('not ({})'.format, inner),
    ),
    max_leaves=3,
)

STATES = st.lists(
    st.fixed_dictionaries(
        {each: st.booleans() if each[0] == 'P' else st.integers(0, 4) for each in FEATURES}
    ),
    min_size=1,
    max_size=8,
)


@given(FORMULAS, STATES, st.sets(st.sampled_from(PEERS)))
def test_the_verdict_is_that_of_the_whole_formula(
    formula: str, states: list[dict[str, Any]], refusing: set[str]
) -> None:
    """At each state: a verdict crosses at the state that decides it, as what it is presumably.

    Only where parts share features, they may contradict each other before one is decided.
    """
    parsed = parse_formula(formula)
    found = PushDown(parsed, DOMAINS, STREAMS)
    seen: list[dict[str, Any]] = [dict(state) for state in states]
    topics: dict[PeerPart, str] = {}
    for number, part in enumerate(found.parts):
        if part.peer in refusing:
            continue
        topics[part] = verdict_topic(part, number)
        own = [{f'{name}_{part.peer}.value': state[f'{name}[{part.peer}]'] for name in 'PX'}
               for state in states]  # fmt: skip
        for state, (verdict, is_pending) in zip(seen, verdicts(part.text, {}, own), strict=True):
            told = PRESUMABLY_FALSE if is_pending else UNDECIDED
            if verdict is not UNKNOWN:
                told = verdict_text(is_true=verdict is Verdict.TRUE, reason='so')
            state[f'"{topics[part]}".value'] = told
    remaining = found.remaining(topics)
    pushed, whole = verdicts(remaining, DOMAINS, seen), verdicts(str(parsed), DOMAINS, states)
    if not may_contradict(found, topics):
        assert pushed == whole
    for state, (verdict, _), (expected, _) in zip(seen, pushed, whole, strict=True):
        told = {state[f'"{each}".value'] for each in topics.values()}
        is_open = not told.isdisjoint({UNDECIDED, PRESUMABLY_FALSE})
        assert verdict is expected or (is_open and verdict is UNKNOWN)


@pytest.mark.parametrize(
    ('told', 'explanation'),
    [
        ('false: P[r1] is "off", not "on"; so', 'P[r1] is "off", not "on"; so'),
        (
            'true: a \\ b\nc',
            'a \\ b\\u000ac; P[r3] is true at 2.000 s (eventually awaited since 0.000 s)',
        ),
    ],
)
def test_the_explanation_of_a_peer_is_given_once(told: str, explanation: str) -> None:
    formula = parse_formula('(always P[r1]) and eventually P[r3]')
    found = PushDown(formula, DOMAINS, STREAMS)
    topic = verdict_topic(found.parts[0], 1)
    group = FormulaGroup()
    group.add_formula('', found.remaining({found.parts[0]: topic}))
    group.begin(DOMAINS)
    assert not group.progress(0, {f'"{topic}".value': UNDECIDED, 'P[r3]': False})
    assert not group.progress(1, {f'"{topic}".value': PRESUMABLY_FALSE, 'P[r3]': False})
    [result] = group.progress(2 * SECOND_NS, {f'"{topic}".value': told, 'P[r3]': True})
    assert with_reasons_of_peers(result.explanation) == explanation


@pytest.mark.parametrize(
    ('waits_for', 'explanation'),
    [
        ('/odom has fallen silent', '/odom has fallen silent'),
        (f'{VERDICT} has fallen silent', "peer 'r1' waits: /r1/odom has fallen silent"),
        (f'{VERDICT} has a publisher but no message has come; nobody publishes /odom',
         "peer 'r1' waits: /r1/odom has fallen silent; nobody publishes /odom"),
        (f'nobody publishes {VERDICT} any more', "peer 'r1' waits: /r1/odom has fallen silent"),
        (f'stream v waits: {VERDICT}2 has fallen silent',
         "stream v waits: peer 'r1' has not told how far it is"),
    ],
)  # fmt: skip
def test_a_host_waits_for_what_its_peer_waits_for(waits_for: str, explanation: str) -> None:
    waits = {VERDICT: '/r1/odom has fallen silent'}
    assert with_waits_of_peers(waits_for, waits) == explanation


def may_contradict(found: PushDown, topics: dict[PeerPart, str]) -> bool:
    """True if two parts, or a part and what remains, are about the same feature."""
    rest = parse_formula(found.remaining(topics))
    apart = [rest, *(part.formula for part in topics)]
    named = Counter(name for each in apart for name in features(each))
    return max(named.values(), default=0) > 1


def features(formula: Any) -> set[str]:
    """The ground features of a formula; all of a sort's for a variable."""
    found = {str(each) for each in walk(formula) if isinstance(each, Feature)}
    return {
        f'{each[0]}[{robot}]'
        for each in found
        for robot in DOMAINS['Robot']
        if each[2:-1] in {'x', 'z', robot}
    }


@pytest.mark.parametrize(
    ('formula', 'parts'),
    [
        ('always P[r1]', ['r1: always P_r1.value']),
        ('forall x in Robot: always P[x]', ['r1: always P_r1.value', 'r2: always P_r2.value']),
        ('exists x in Robot: eventually P[x]',
         ['r1: eventually P_r1.value', 'r2: eventually P_r2.value']),
        ('(always P[r1]) and always P[r1]',
         ['r1: (always P_r1.value) and (always P_r1.value)']),
        ('(always P[r1]) -> not eventually X[r2] > 1',
         ['r1: always P_r1.value', 'r2: not (eventually (X_r2.value > 1))']),
        # Only here is it known at which states the other ones matter.
        ('always (P[r3] -> eventually P[r1])', []),
        ('always (P[r1] or P[r2])', []),
        # Without time, a value is as short as a verdict.
        ('P[r1]', []),
        ('once P[r1]', []),
        ('always max(X[x] for x in Robot) > 1', []),
        ('P(always normal(X[r1], 1) > 1) > 0.9', []),
        ('always P[r3]', []),
        ('always "/r1/battery".percentage > 1', []),
        # A guard asks for states in this way: no verdict would come.
        ('forall x in Robot: (always[500000 h, 500000 h] (X[x] = X[x]))', []),
        ('always (P[r1] -> eventually[500000 h, 500000 h] P[r1])', []),
        ('always[0 s, 500000 h] P[r1]', ['r1: always[0 s, 1800000000 s] P_r1.value']),
    ],
)  # fmt: skip
def test_parts(formula: str, parts: list[str]) -> None:
    found = PushDown(parse_formula(formula), DOMAINS, STREAMS).parts
    assert [f'{each.peer}: {each.text}' for each in found] == parts


def test_what_remains_needs_no_stream_of_the_others() -> None:
    found = PushDown(parse_formula('forall x in Robot: always P[x]'), DOMAINS, STREAMS)
    group = FormulaGroup()
    group.add_formula('', found.remaining({each: f'/{each.peer}' for each in found.parts}))
    group.begin(DOMAINS)
    names = {str(each) for each in group.symbols() if each.name not in DOMAINS}
    assert {each for each in names if '[' in each} == {'P[r3]'}


def test_a_formula_that_is_too_large_stays_here() -> None:
    many = {'Robot': tuple(f'r{number}' for number in range(MAX_NODES // 3))}
    formula = parse_formula('forall x in Robot: always P[x]')
    found = PushDown(formula, many, {f'P[{each}]': ('r1', 'P') for each in many['Robot']})
    assert found.parts == ()
    assert found.remaining({}) == str(formula)


@pytest.mark.parametrize('name', ['r-1', 'r.1', 'max', 'once'])
def test_an_object_that_no_text_can_name(name: str) -> None:
    """Its part can be evaluated elsewhere; if others remain, they could not be told from it."""
    formula = parse_formula('forall x in Robot: always P[x]')
    streams = {f'P[{name}]': ('r1', 'P_r1')}
    alone = PushDown(formula, {'Robot': (name,)}, streams)
    assert [each.text for each in alone.parts] == ['always P_r1.value']
    assert alone.remaining({alone.parts[0]: '/v'})
    with_others = PushDown(formula, {'Robot': (name, 'r3')}, streams)
    assert with_others.remaining(dict.fromkeys(with_others.parts, '/v')) == ''


@pytest.mark.parametrize('names', ['x y', 'r1 y', 'x r1', 'x r3'])
def test_a_variable_with_the_name_of_an_object(names: str) -> None:
    outer, inner = names.split()
    text = f'forall {outer} in Robot: ((always P[{outer}]) or (exists {inner} in Robot: '
    text += f'({inner} != {outer} and (always P[{outer}]))))'
    found = PushDown(parse_formula(text), DOMAINS, STREAMS)
    remaining = found.remaining(dict.fromkeys(found.parts, '/v'))
    assert bool(remaining) is ('r1' not in names)
    if remaining:
        FormulaGroup().add_formula('', remaining)


@pytest.mark.parametrize(
    ('formula', 'message'),
    [
        ('always P_r1.value', ''),
        ('always P_r1.value and', "'always P_r1.value and' is no formula here: "),
        ('always P[r1]', "'always P[r1]' is not about streams alone"),
        ('forall x in Robot: always P_r1.value', 'is not about streams alone'),
        ('always max(P_r1.a, P_r1.b) > 1 and P(normal(P_r1.a, 1) > 1) > 0.5', 'is not about'),
        ('always Q_r1.value', "'Q_r1' is not shared; name it in share there"),
        ('always "/secret".value > 1', "'/secret' is not shared"),
    ],
)
def test_a_formula_of_a_peer_is_checked(formula: str, message: str) -> None:
    if not message:
        assert streams_of(formula, ['P_r1']) == {'P_r1'}
        assert with_prefix(formula, '_own_') == 'always _own_P_r1.value'
        return
    with pytest.raises(FederationError) as caught:
        streams_of(formula, ['P_r1'])
    assert message in caught.value.message


def test_a_long_reason_is_cut_to_what_crosses() -> None:
    text = verdict_text(is_true=False, reason='ü' * MAX_LENGTH)
    assert text.startswith('false: üü')
    assert MAX_LENGTH - 2 < len(text.encode()) <= MAX_LENGTH
