"""A formula over uncertain states is decided only where all choices give the same verdict."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import accumulate, product

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import LEAVES, NAMES, Trace, begun, holds, intervals

from dyknow_common import Value, Verdict
from dyknow_reasoning import ReasoningError, UncertainFormula
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Equivalent,
    Eventually,
    Formula,
    Implies,
    Not,
    Or,
    Until,
)

STATES = [dict(zip(NAMES, bits, strict=True)) for bits in product((False, True), repeat=2)]
NEVER = -1
"""The state of an outcome that is none."""

Uncertain = Sequence[tuple[int, Sequence[dict[str, Value]]]]
"""The alternatives of each state."""


def deeper(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    connectives = [st.builds(kind, inner, inner) for kind in (And, Or, Implies, Equivalent)]
    temporal = [st.builds(kind, inner, intervals()) for kind in (Always, Eventually)]
    until = st.builds(Until, inner, inner, intervals())
    return st.one_of(st.builds(Not, inner), *connectives, *temporal, until)


FORMULAS = deeper(deeper(deeper(LEAVES) | LEAVES) | LEAVES)


@st.composite
def uncertain_traces(draw: st.DrawFn, *, missing: bool = False) -> Uncertain:
    steps = draw(st.lists(st.integers(1, 4), min_size=1, max_size=7))
    choices = st.lists(st.sampled_from(STATES), min_size=1, max_size=2, unique_by=str)
    found: list[tuple[int, Sequence[dict[str, Value]]]] = []
    for time in accumulate(steps):
        alternatives = draw(choices)
        unknown = draw(st.sets(st.sampled_from(NAMES))) if missing and found else ()
        found.append(
            (time, [{n: v for n, v in each.items() if n not in unknown} for each in alternatives])
        )
    return found


def outcome(formula: Formula, trace: Uncertain) -> tuple[Verdict | None, int]:
    """The verdict and its state; None for an error, UNDECIDED at the state NEVER without."""
    evaluated, verdict = UncertainFormula(str(formula), {}), Verdict.UNDECIDED
    for number, (time, alternatives) in enumerate(trace):
        try:
            verdict = evaluated.progress(time, alternatives, 'the clocks differ')
        except ReasoningError as error:
            return None if 'the clocks differ: too much' in str(error) else verdict, number
        if verdict is not Verdict.UNDECIDED:
            return verdict, number
    return Verdict.UNDECIDED, NEVER


def chosen(trace: Uncertain) -> list[Trace]:
    """All traces that may be the true one."""
    times = [time for time, _ in trace]
    filled = [
        [dict(each) for values in alternatives for each in STATES if values.items() <= each.items()]
        for _, alternatives in trace
    ]
    return [list(zip(times, values, strict=True)) for values in product(*filled)]


def verdicts(formula: Formula, trace: Trace) -> list[Verdict]:
    """The verdict of a group after each state."""
    group, _ = begun(str(formula))
    found, verdict = [], Verdict.UNDECIDED
    for time, values in trace:
        for result in group.progress(time, values):
            verdict = result.verdict
        found.append(verdict)
    return found


@given(FORMULAS, uncertain_traces())
def test_all_choices_are_evaluated(formula: Formula, trace: Uncertain) -> None:
    told, number = outcome(formula, trace)
    found = [verdicts(formula, each) for each in chosen(trace)]
    expected: tuple[Verdict | None, int] = Verdict.UNDECIDED, NEVER
    for state in range(len(trace)):
        possible = {each[state] for each in found}
        if possible >= {Verdict.TRUE, Verdict.FALSE}:
            expected = None, state
            break
        if possible in ({Verdict.TRUE}, {Verdict.FALSE}):
            expected = possible.pop(), state
            break
    assert (told, number) == expected, str(formula)


@given(FORMULAS, uncertain_traces(missing=True))
def test_no_verdict_is_wrong(formula: Formula, trace: Uncertain) -> None:
    told, number = outcome(formula, trace)
    if told in {Verdict.TRUE, Verdict.FALSE}:
        for each in chosen(trace):
            assert holds(formula, each, 0) in {told is Verdict.TRUE, None}, str(formula)
            # What comes later must not matter, either.
            assert holds(formula, each[: number + 1], 0) in {told is Verdict.TRUE, None}


def test_an_instance_decides_for_all() -> None:
    formula = UncertainFormula('forall x in S: always[0 s, 1 s] P[x]', {'S': ['a', 'b']})
    unknown = [{'P[a]': True, 'P[b]': True}, {'P[a]': False, 'P[b]': True}]
    assert formula.progress(0, unknown, 'a') is Verdict.UNDECIDED
    assert formula.progress(1, [{'P[a]': True, 'P[b]': False}]) is Verdict.FALSE


def test_the_error_names_the_clocks_and_the_window() -> None:
    formula = UncertainFormula('always[0 s, 1 s] (p -> eventually[0 s, 0.5 s] q)', {})
    reason = 'the clocks of a and b differ by 1.2 s plus or minus 0.4 s'
    formula.progress(0, [{'p': True, 'q': False}])
    formula.progress(400_000_000, [{'p': False, 'q': False}, {'p': False, 'q': True}], reason)
    with pytest.raises(ReasoningError, match=r'0\.4 s: too much for a window of 500 ms'):
        formula.progress(2_000_000_000, [{'p': False, 'q': False}])


def test_a_doubt_is_told_while_the_formula_goes_on() -> None:
    formula = UncertainFormula('always p', {})
    formula.progress(0, [{'p': True}])
    assert not formula.doubt
    assert formula.progress(1, [{'p': True}, {'p': False}], 'lost') is Verdict.UNDECIDED
    assert formula.doubt == 'lost: too much for this formula'
    assert formula.progress(2, [{'p': False}]) is Verdict.FALSE


def test_states_are_skipped_until_all_is_known() -> None:
    formula = UncertainFormula('p and eventually[0 s, 1 s] q', {})
    assert formula.progress(0, [{'p': False}]) is Verdict.UNDECIDED
    assert formula.progress(1, [{'p': True, 'q': True}]) is Verdict.TRUE


def test_the_past_is_refused() -> None:
    with pytest.raises(ReasoningError, match="'once p' looks into the past"):
        UncertainFormula('always (q -> once p)', {})
