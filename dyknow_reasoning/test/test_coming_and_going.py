"""Formulas that come to a group and leave it while it is progressed."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reasoning_reference import Trace, begun, formulas, progressed, random_cases, started
from test_progression import traces

from dyknow_common import ExitCode, Verdict
from dyknow_reasoning import FormulaGroup, FormulaResult, ReasoningError, formula_group
from dyknow_reasoning.execution import instance_pool
from dyknow_reasoning.language.formula import Formula

ARRIVALS = st.lists(st.tuples(st.integers(0, 9), formulas(3)), min_size=1, max_size=6)


def plain(result: FormulaResult) -> FormulaResult:
    """A result that compares by what is told, whichever group it is from."""
    explanation = result.explanation or str(result.error)
    return replace(result, formula_id=0, explanation=explanation, error=None)


def alone(formula: Formula, trace: Trace) -> list[FormulaResult]:
    return [plain(result) for result in progressed(started(str(formula)), trace)]


@pytest.mark.parametrize(('batch', 'many'), list(product((1, 1000), (False, True))))
@settings(max_examples=random_cases(20))
@given(ARRIVALS, st.sets(st.integers(0, 5)), traces(st.integers(1, 2), most=12))
def test_each_formula_is_as_in_a_group_of_its_own(
    batch: int,
    many: bool,  # noqa: FBT001
    arrivals: list[tuple[int, Formula]],
    leaving: set[int],
    trace: Trace,
) -> None:
    """Those that come later begin with the next state; some leave three states later."""
    group = FormulaGroup()
    group.begin({})
    found: dict[int, list[FormulaResult]] = {}
    spans: dict[int, tuple[Formula, int, int]] = {}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(instance_pool, '_MIN_BATCH_SIZE', batch)
        for index, (time, values) in enumerate(trace):
            for number, (begin, formula) in enumerate(arrivals):
                if begin == index:
                    formula_id = group.add_formula(str(formula), str(formula))
                    end = index + 3 if number in leaving else len(trace)
                    spans[formula_id] = formula, index, end
            for formula_id, (_, _, end) in spans.items():
                if end == index:
                    group.remove_formula(formula_id)
            columns = {name: [value] for name, value in values.items()}
            told = group.progress_many([time], columns) if many else group.progress(time, values)
            for result in told:
                found.setdefault(result.formula_id, []).append(plain(result))
    for formula_id, (formula, begin, end) in spans.items():
        assert found.get(formula_id, []) == alone(formula, trace[begin:end])


@pytest.mark.parametrize(
    'asked', [{}, {'margin': True}, {'every_state': True}, {'every_state': True, 'margin': True}]
)
@settings(max_examples=random_cases(30))
@given(
    formulas(3),
    st.integers(0, 6),
    st.integers(-3, 9),
    st.integers(0, 2),
    st.sets(st.integers(0, 9)),
    traces(st.integers(2, 3), most=12),
)
def test_a_formula_that_waits_is_as_one_that_comes_at_its_first_state(  # noqa: C901
    asked: dict[str, bool],
    formula: Formula,
    added: int,
    begins: int,
    late: int,
    gaps: set[int],
    trace: Trace,
) -> None:
    """Also in a group that has not begun, beside another formula, and after gaps."""
    times = [time for time, _ in trace]
    since = times[begins] - late if 0 <= begins < len(times) else (begins < 0) - 1 + 10**9
    waiting, coming = FormulaGroup(), FormulaGroup()
    for group in (waiting, coming):
        group.add_formula('other', 'always (p -> eventually[0, 4 ns] q)')
    if added == 0:
        number = waiting.add_formula('it', str(formula), since=since, **asked)
    for group in (waiting, coming):
        group.begin({})
    for index, (time, values) in enumerate(trace):
        if index == added and added > 0:
            number = waiting.add_formula('it', str(formula), since=since, **asked)
        has_come = 2 in coming.formulas
        if index >= added and not has_come and (time >= since or not waiting.waiting):
            coming.add_formula('it', str(formula), **asked)
        told = []
        for group in (waiting, coming):
            if index in gaps:
                group.gap()
            told.append([plain(each) for each in group.progress(time, values)])
        if has_come and 2 in waiting.formulas:
            assert waiting.residual(number) == coming.residual(number)
            assert waiting.presumably_false(number) == coming.presumably_false(number)
            assert waiting.margin(number) == coming.margin(number)
            assert waiting.standing.summary(number) == coming.standing.summary(number)
            assert not waiting.waiting
        elif 2 in waiting.formulas and number in waiting.waiting:
            assert waiting.residual(number) == str(formula)
            fresh, _ = begun(str(formula), **asked)
            assert waiting.presumably_false(number) == fresh.presumably_false(1)
            assert waiting.margin(number) == fresh.margin(1)
            told[0] = [each for each in told[0] if each.name != 'it']
        assert told[0] == told[1]


def test_a_formula_that_comes_later() -> None:
    group, first = begun('forall x in S: always P[x]', {'S': ['a', 'b']})
    assert group.progress(0, {'P[a]': True, 'P[b]': True}) == []
    second = group.add_formula('second', 'exists x in S: eventually[0, 5 ns] Q[x]')
    assert {str(symbol) for symbol in group.symbols()} == {'P[a]', 'P[b]', 'Q[a]', 'Q[b]'}
    assert group.residual(second) == str(group.formulas[second])
    assert [group.presumably_false(each) for each in (first, second)] == [False, True]
    [failed] = group.progress(1, {'P[a]': True, 'P[b]': True})
    assert "no field 'Q[a]'" in str(failed.error)
    group.remove_formula(second)
    assert {str(symbol) for symbol in group.symbols()} == {'P[a]', 'P[b]'}
    assert group.undecided == {first}
    assert group.add_formula('third', 'true') == second + 1
    [known] = group.decided_at_once()
    assert (known.verdict, known.decided_at) == (Verdict.TRUE, None)
    group.add_formula('fourth', 'false')
    [known] = group.progress(2, {'P[a]': True, 'P[b]': True})
    assert (known.verdict, known.decided_at) == (Verdict.FALSE, None)


def test_a_formula_that_is_not_there_cannot_be_removed() -> None:
    group = FormulaGroup()
    number = group.add_formula('p', 'p')
    group.remove_formula(number)
    with pytest.raises(ReasoningError, match=f'no formula {number}') as caught:
        group.remove_formula(number)
    assert caught.value.code is ExitCode.NOT_FOUND
    group.begin({})
    assert group.progress(0, {}) == []


def test_a_group_forgets_the_formulas_that_have_left(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(formula_group, '_MAX_NODES', 100)
    group = FormulaGroup()
    group.begin({})
    for time in range(300):
        number = group.add_formula('p', f'always (p -> eventually[0, {time} ms] q)')
        assert group.progress(time, {'p': True, 'q': True}) == []
        group.remove_formula(number)
    assert not group.formulas
    assert not group.symbols()
    assert len(group._store) < 2 * 100


@pytest.mark.parametrize(
    ('text', 'values', 'expected'),
    [
        ('always p', {'p': True}, False),
        ('eventually q', {'q': False}, True),
        ('p until q', {'p': True, 'q': False}, True),
        ('not (p until q)', {'p': True, 'q': False}, False),
        ('always (p -> eventually q)', {'p': True, 'q': False}, True),
        ('always (p -> eventually q)', {'p': False, 'q': False}, False),
        ('(eventually q) or always p', {'p': True, 'q': False}, False),
    ],
)
def test_presumably_false(text: str, values: dict[str, bool], expected: bool) -> None:  # noqa: FBT001
    group, number = begun(text)
    assert group.progress(0, values) == []
    assert group.presumably_false(number) is expected


def test_presumably_false_once_it_is_known() -> None:
    group = FormulaGroup()
    texts = ('always p', 'eventually p', 'false', 'always r')
    numbers = [group.add_formula(text, text) for text in texts]
    group.begin({})
    assert group.presumably_false(numbers[2])
    assert len(group.progress(0, {'p': True})) == 3
    assert [group.presumably_false(each) for each in numbers] == [False, False, True, False]
    assert len(group.progress(1, {'p': False})) == 1
    assert group.presumably_false(numbers[0])
