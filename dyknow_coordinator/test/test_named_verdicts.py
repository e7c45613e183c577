"""Topics of named formulas: what they are called, and what is on them."""

from dataclasses import replace
from string import ascii_letters, digits

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import ExitCode, Margin, Verdict
from dyknow_coordinator import (
    CoordinationError,
    EvaluationPhase,
    EvaluationStatus,
    StandingVerdicts,
    ViolationEpisode,
)
from dyknow_coordinator.reporting.verdict_topics import (
    MAX_TOKEN,
    NamedVerdict,
    VerdictTopicNames,
    verdict_token,
)

SECOND = 1_000_000_000
RUNNING = EvaluationStatus(
    'power',
    'always (Power[uav1] < 200)',
    EvaluationPhase.RUNNING,
    started=90 * SECOND,
    states_progressed=7,
    latest_valid_time=99 * SECOND,
    presumably_false=True,
)
EPISODE = ViolationEpisode(98 * SECOND, 98 * SECOND, 102 * SECOND, 1, False, 'because')


def named(name: str, *, ended: bool = False) -> EvaluationStatus:
    return replace(
        RUNNING, name=name, phase=EvaluationPhase.ENDED if ended else EvaluationPhase.RUNNING
    )


@pytest.mark.parametrize(
    ('name', 'token'),
    [
        ('power', 'power'),
        ('no surge', 'no_surge'),
        ('Not_empty 2', 'Not_empty_2'),
        ('at 5 m!', 'at_5_m_825db33b'),
        ('3d', 'd_ff6dd28e'),
        ('a__b', 'a_b_5ba16718'),
        ('_hidden', 'hidden_716e0e3e'),
        ('höhe/uav1', 'h_he_uav1_2ed7c712'),
        ('高度', 'formula_713cde81'),
    ],
)
def test_tokens(name: str, token: str) -> None:
    assert verdict_token(name) == token


@given(st.text(min_size=1, max_size=200))
def test_every_name_has_a_valid_token(name: str) -> None:
    token = verdict_token(name)
    assert set(token) <= {*ascii_letters, *digits, '_'}
    assert token[0] in ascii_letters
    assert '__' not in token
    assert len(token) <= MAX_TOKEN


@given(*[st.text('ab_! 1', min_size=1, max_size=8)] * 2)
def test_different_names_differ_in_more_than_their_spaces(one: str, other: str) -> None:
    if one.replace(' ', '_') != other.replace(' ', '_'):
        assert verdict_token(one) != verdict_token(other)


def test_a_second_evaluation_of_a_name_has_a_topic_of_its_own() -> None:
    names = VerdictTopicNames(10)
    first = names.assign({'1': named('power')})
    assert list(first) == ['power']
    second = names.assign({'1': named('power'), '2': named('power'), '3': named('speed')})
    assert list(second) == ['power', 'power_2', 'speed']
    # The second one keeps its topic when the first one is forgotten.
    third = names.assign({'2': named('power'), '3': named('speed')})
    assert sorted(third) == ['power_2', 'speed']


def test_a_topic_of_an_ended_evaluation_is_continued_by_the_next_of_its_name() -> None:
    names = VerdictTopicNames(10)
    names.assign({'1': named('no surge')})
    ended, new = named('no surge', ended=True), named('no surge')
    assert names.assign({'1': ended, '2': new}) == {'no_surge': new}
    # The first one does not take another topic instead.
    assert names.assign({'1': ended, '2': new}) == {'no_surge': new}
    assert names.assign({'2': new}) == {'no_surge': new}
    assert names.assign({}) == {}


def test_a_topic_of_another_name_is_not_continued() -> None:
    names = VerdictTopicNames(10)
    one, other = named('no surge', ended=True), named('no_surge')
    assert names.assign({'1': one, '2': other}) == {'no_surge': one, 'no_surge_2': other}


def test_topics_are_limited_and_those_of_ended_evaluations_make_room() -> None:
    names = VerdictTopicNames(2)
    running = {each: named(each) for each in 'abc'}
    assert list(names.assign(running)) == ['a', 'b']
    assert names.without == ('c',)
    ended = {**running, 'a': named('a', ended=True)}
    assert sorted(names.assign(ended)) == ['b', 'c']
    assert names.without == ()


@given(
    st.lists(
        st.dictionaries(
            st.sampled_from('123456'),
            st.tuples(st.sampled_from(['a', 'a b', 'a_b']), st.booleans()),
        ),
        max_size=8,
    )
)
def test_assignment(steps: list[dict[str, tuple[str, bool]]]) -> None:
    """Whatever runs: each topic has one evaluation, and none that runs changes its topic."""
    names, before, ended = VerdictTopicNames(4), dict[str, str](), set[str]()
    for step in steps:
        ended |= {f'{name}{key}' for key, (name, ends) in step.items() if ends}
        evaluations = {
            f'{name}{key}': named(name, ended=f'{name}{key}' in ended)
            for key, (name, _) in step.items()
        }
        found = names.assign(evaluations)
        tokens = {id(status): token for token, status in found.items()}
        now = {key: tokens[id(each)] for key, each in evaluations.items() if id(each) in tokens}
        running = {
            key for key, each in evaluations.items() if each.phase is EvaluationPhase.RUNNING
        }
        assert len(found) == len(now) <= 4
        assert all(found[token].name == evaluations[key].name for key, token in now.items())
        assert all(now[key] == before[key] for key in before.keys() & running)
        assert len(running & now.keys()) == min(len(running), 4)
        before = {key: token for key, token in now.items() if key in running}


def test_an_undecided_formula() -> None:
    found = NamedVerdict.of(replace(RUNNING, margin=Margin(-1.0, 2.0)))
    assert found == NamedVerdict(
        99 * SECOND,
        'power',
        Verdict.UNDECIDED,
        is_violated=False,
        presumably_false=True,
        margin=Margin(-1.0, 2.0),
        error=None,
    )


@pytest.mark.parametrize('verdict', [Verdict.TRUE, Verdict.FALSE])
def test_a_verdict_is_newer_than_the_progress(verdict: Verdict) -> None:
    found = NamedVerdict.of(
        replace(RUNNING, phase=EvaluationPhase.ENDED, verdict=verdict, decided_at=99 * SECOND + 5)
    )
    is_false = verdict is Verdict.FALSE
    assert (found.is_violated, found.presumably_false) == (is_false, is_false)
    assert found.stamp == 99 * SECOND + 5


def test_a_formula_that_is_asked_at_every_state_is_violated_while_an_episode_lasts() -> None:
    episodes = StandingVerdicts(5, 1, 0, 0, True, 1, (EPISODE,))
    found = NamedVerdict.of(replace(RUNNING, episodes=episodes))
    assert (found.is_violated, found.stamp) == (True, 102 * SECOND)
    over = replace(episodes, is_violated=False)
    ended = replace(RUNNING, episodes=over, verdict=Verdict.FALSE, phase=EvaluationPhase.ENDED)
    assert not NamedVerdict.of(ended).is_violated


def test_an_error_is_no_violation() -> None:
    error = CoordinationError('late', ExitCode.TIMEOUT)
    found = NamedVerdict.of(
        replace(RUNNING, latest_valid_time=None, phase=EvaluationPhase.ENDED, error=error)
    )
    assert (found.verdict, found.is_violated, found.stamp) == (Verdict.UNDECIDED, False, 0)
    assert found.error is error
