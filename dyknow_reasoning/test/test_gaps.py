"""No verdict depends on states that are missing."""

from __future__ import annotations

import re
from itertools import accumulate, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reasoning_reference import (
    NAMES,
    Trace,
    formulas,
    holds,
    progressed,
    progressed_many,
    random_cases,
    started,
)

from dyknow_common import ExitCode, Verdict, round_time
from dyknow_reasoning import FormulaGroup, FormulaResult
from dyknow_reasoning.execution import instance_pool
from dyknow_reasoning.language.formula import Formula

STATES = [dict(zip(NAMES, bits, strict=True)) for bits in product((False, True), repeat=2)]

Segments = list[Trace]
"""Parts of a trace with a gap between each and the next."""


def results(group: FormulaGroup, segments: Segments) -> list[FormulaResult]:
    found = []
    for number, segment in enumerate(segments):
        if number:
            group.gap()
        found += progressed(group, segment)
    return found


def verdict(formula: Formula, segments: Segments) -> FormulaResult | None:
    found = results(started(str(formula)), segments)
    assert len(found) <= 1
    return found[0] if found else None


@st.composite
def segments(draw: st.DrawFn) -> Segments:
    """Two or three segments; there is time for states between them, or there is none."""
    found: Segments = []
    time = 0
    for length in draw(st.lists(st.integers(1, 4), min_size=2, max_size=3)):
        steps = draw(st.lists(st.integers(1, 4), min_size=length, max_size=length))
        steps[0] += draw(st.integers(0, 6))
        times = list(accumulate(steps, initial=time))[1:]
        found.append([(each, draw(st.sampled_from(STATES))) for each in times])
        time = times[-1]
    return found


@st.composite
def fillings(draw: st.DrawFn, found: Segments) -> Trace:
    """A trace that may be what the segments are of."""
    trace = list(found[0])
    for segment in found[1:]:
        times = range(trace[-1][0] + 1, segment[0][0])
        missing = draw(st.sets(st.sampled_from(times))) if times else ()
        trace += [(time, draw(st.sampled_from(STATES))) for time in sorted(missing)]
        trace += segment
    return trace


def check_sound(result: FormulaResult | None, formula: Formula, filled: Trace) -> None:
    if result and result.error:
        assert result.error.code is ExitCode.CONSTRAINT_VIOLATION
        assert 'depends on states that are missing between' in result.error.message
    elif result:
        told = result.verdict is Verdict.TRUE
        assert holds(formula, filled, 0) in {told, None}, (str(formula), filled)
        without_gap = verdict(formula, [filled])
        assert without_gap is None or without_gap.verdict is result.verdict


@settings(max_examples=random_cases(100))
@given(formulas(), segments(), st.data())
def test_no_verdict_depends_on_what_is_missing(
    formula: Formula, found: Segments, data: st.DataObject
) -> None:
    result = verdict(formula, found)
    for _ in range(4):
        check_sound(result, formula, data.draw(fillings(found)))


def all_fillings(first: Trace, last: Trace) -> list[Trace]:
    """With at most one state at each time of the gap."""
    times = range(first[-1][0] + 1, last[0][0])
    choices = product((None, *STATES), repeat=len(times))
    return [
        [*first, *((t, s) for t, s in zip(times, states, strict=True) if s is not None), *last]
        for states in choices
    ]


@given(
    formulas(2),
    st.lists(st.sampled_from(STATES), min_size=1, max_size=2),
    st.integers(1, 3),
    st.lists(st.sampled_from(STATES), min_size=1, max_size=4),
)
def test_all_fillings_of_small_gaps(
    formula: Formula, before: list[dict[str, bool]], step: int, after: list[dict[str, bool]]
) -> None:
    first = list(enumerate(before))
    last = list(enumerate(after, len(before) - 1 + step))
    result = verdict(formula, [first, last])
    for filled in all_fillings(first, last):
        check_sound(result, formula, filled)


OBJECTS = ('a', 'b', 'c')


@st.composite
def fleets(draw: st.DrawFn) -> dict[str, Segments]:
    """Segments of each object, at the same times."""
    found = draw(segments())
    return {
        name: [[(time, draw(st.sampled_from(STATES))) for time, _ in segment] for segment in found]
        for name in OBJECTS
    }


def together(fleet: dict[str, Segments]) -> list[list[tuple[int, dict[str, bool]]]]:
    """The states of all objects as one state."""
    joined = []
    for parts in zip(*fleet.values(), strict=True):
        rows = zip(*parts, strict=True)
        joined.append(
            [
                (
                    row[0][0],
                    {
                        f'{feature}[{name}]': state[feature]
                        for name, (_, state) in zip(fleet, row, strict=True)
                        for feature in NAMES
                    },
                )
                for row in rows
            ]
        )
    return joined


def at_once(group: FormulaGroup, found: Segments) -> list[FormulaResult]:
    told = []
    for number, segment in enumerate(found):
        if number:
            group.gap()
        told += progressed_many(group, segment)
    return told


@given(formulas(3), fleets(), st.data())
def test_instances_in_a_gap(
    formula: Formula, fleet: dict[str, Segments], data: st.DataObject
) -> None:
    """By themselves or together, one by one or at once: all the same, and sound."""
    of_x = re.sub(r'\b[pq]\b', lambda name: f'{name[0]}[x]', str(formula))
    text = f'forall x in S: ({of_x})'
    told = []
    for batch, progress in product((1, 1000), (results, at_once)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(instance_pool, '_MIN_BATCH_SIZE', batch)
            found = progress(started(text, domains={'S': OBJECTS}), together(fleet))
            told.append([(each.verdict, each.explanation, str(each.error)) for each in found])
    assert all(each == told[0] for each in told)
    if found and found[0].verdict is Verdict.TRUE:
        for each in fleet.values():
            assert holds(formula, data.draw(fillings(each)), 0) is not False
    if found and found[0].verdict is Verdict.FALSE and found[0].decided_at is not None:
        [guilty] = re.findall('for x = ([abc]): ', found[0].explanation)[:1] or ['']
        if guilty:
            assert holds(formula, data.draw(fillings(fleet[guilty])), 0) is not True


@given(formulas(), segments())
def test_a_gap_without_time_for_a_state_changes_nothing(formula: Formula, found: Segments) -> None:
    trace = [state for segment in found for state in segment]
    moved = [(time, values) for time, (_, values) in enumerate(trace)]
    split = len(found[0])
    assert verdict(formula, [moved[:split], moved[split:]]) == verdict(formula, [moved])


MS = 1_000_000


def in_milliseconds(*found: Trace) -> Segments:
    return [[(time * MS, values) for time, values in segment] for segment in found]


TRUE_AT_12, FALSE_AT_12 = (Verdict.TRUE, 12), (Verdict.FALSE, 12)
P, NOT_P, Q = ({'p': p, 'q': q} for p, q in ((True, False), (False, False), (False, True)))


@pytest.mark.parametrize(
    ('text', 'before', 'after', 'expected'),
    [
        ('always p', [(0, P)], [(9, P), (10, NOT_P)], (Verdict.FALSE, 10)),
        ('eventually not p', [(0, P)], [(9, P), (10, NOT_P)], (Verdict.TRUE, 10)),
        ('always[0, 3 ms] p', [(0, P)], [(9, P)], 9),
        ('always[0, 20 ms] p', [(0, P)], [(9, P), (20, P)], 20),
        ('always[0, 20 ms] p', [(0, P)], [(9, P), (19, NOT_P)], (Verdict.FALSE, 19)),
        ('eventually[0, 20 ms] not p', [(0, P)], [(9, P), (20, P)], 20),
        ('eventually[0, 20 ms] not p', [(0, P)], [(9, NOT_P)], (Verdict.TRUE, 9)),
        ('eventually[9 ms, 20 ms] not p', [(0, P)], [(9, P), (20, P)], (Verdict.FALSE, 20)),
        ('always[9 ms, 20 ms] p', [(0, P)], [(9, P), (20, P)], (Verdict.TRUE, 20)),
        ('p until[9 ms, 20 ms] q', [(0, P)], [(9, P), (10, NOT_P)], (Verdict.FALSE, 10)),
        ('p until q', [(0, P)], [(9, P)], 9),
        ('always (p -> eventually[0, 3 ms] not p)', [(0, P)], [(9, P), (12, P)], FALSE_AT_12),
        ('(always p) or eventually q', [(0, P)], [(9, NOT_P), (12, Q)], TRUE_AT_12),
        ('(always p) and eventually q', [(0, P)], [(9, NOT_P)], (Verdict.FALSE, 9)),
        ('(eventually q) or always[9 ms, 12 ms] p', [(0, P)], [(9, P), (12, P)], TRUE_AT_12),
        ('not (p until q)', [(0, P)], [(9, P), (10, NOT_P)], 9),
    ],
)  # fmt: skip
def test_which_verdicts_are_still_possible(
    text: str, before: Trace, after: Trace, expected: tuple[Verdict, int] | int
) -> None:
    [found] = results(started(text), in_milliseconds(before, after))
    if isinstance(expected, int):
        assert str(found.error) == (
            f'at {round_time(expected * MS)}: the verdict depends on states that are missing '
            'between 0.000 s and 0.009 s'
        )
    else:
        assert (found.verdict, found.decided_at) == (expected[0], expected[1] * MS)


@given(formula=formulas(3), found=segments(), is_standing=st.booleans())
def test_a_probability_of_one_state_looks_back_to_none(
    *, formula: Formula, found: Segments, is_standing: bool
) -> None:
    """For a number p of 0 or 1, `P(normal(p, 1) > 0.5) > 0.5` is like a boolean p, also at gaps."""
    text = str(formula)
    plain = started(text, every_state=is_standing)
    likely = re.sub(r'\bp\b', '(P(normal(p, 1) > 0.5) > 0.5)', text)
    asked = started(likely, every_state=is_standing)
    numbers: Segments = [
        [(time, {**values, 'p': float(values['p'])}) for time, values in segment]
        for segment in found
    ]
    expected, actual = results(plain, found), results(asked, numbers)
    assert [(each.verdict, each.decided_at, str(each.error)) for each in actual] == [
        (each.verdict, each.decided_at, str(each.error)) for each in expected
    ]
    told, wanted = (
        [each.monitor.counts() for each in group.standing.formulas.values()]
        for group in (asked, plain)
    )
    assert told == wanted


def test_a_gap_may_hide_a_single_state() -> None:
    [found] = results(started('always[0, 2 ns] p'), [[(0, P)], [(2, P)]])
    assert found.error is not None


def test_an_explanation_mentions_the_gap_where_it_matters() -> None:
    texts = ('always p', 'always[9 ms, 20 ms] p')
    found = results(started(*texts), in_milliseconds([(0, P)], [(9, P), (10, NOT_P)]))
    explanations = [each.explanation for each in found]
    assert explanations[0].endswith(
        '; so it is whatever the states were that are missing between 0.000 s and 0.009 s'
    )
    assert 'missing' not in explanations[1]


def test_a_formula_is_false_for_one_object_though_another_is_unknown() -> None:
    group = started(
        'forall x in S: (A[x] -> always B[x]) and eventually B[x]', domains={'S': ['a', 'b']}
    )
    state = {'A[a]': False, 'A[b]': True, 'B[a]': False, 'B[b]': True}
    assert group.progress(0, state) == []
    group.gap()
    assert group.progress(9, state) == []
    [result] = group.progress(10, state | {'B[b]': False})
    assert result.verdict is Verdict.FALSE
    assert 'x = b' in result.explanation


def test_what_is_told_of_a_formula_after_a_gap() -> None:
    texts = ('always p', 'eventually q', '(eventually[9 ns, inf) q) or always p')
    group = started(*texts)
    group.progress(0, P)
    group.gap()
    assert group.progress(9, P) == []
    assert [group.residual(each) for each in (1, 2, 3)] == [
        'always p',
        'eventually q',
        '(eventually q) or (always p)',
    ]
    assert [group.presumably_false(each) for each in (1, 2, 3)] == [False, True, False]


def test_a_gap_before_the_first_state_is_none() -> None:
    group = started('always[0, 1 ns] p')
    group.gap()
    assert group.progress(5, P) == []
    [result] = group.progress(6, P)
    assert result.verdict is Verdict.TRUE


def test_typical_formulas_go_on_with_one_half() -> None:
    group = started('always p', 'eventually q')
    group.progress(0, P)
    for time in range(10, 100, 10):
        group.gap()
        assert group.progress(time, P) == []
    assert group._monitor is not None
    assert len(list(group._monitor.states())) == 2
