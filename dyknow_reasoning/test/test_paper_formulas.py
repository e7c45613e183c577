"""The formulas that the paper prints, in its symbols."""

# ruff: noqa: RUF001 - the symbols of the paper

from __future__ import annotations

import pytest

from dyknow_common import LanguageError
from dyknow_reasoning import FormulaGroup, ReasoningError, parse_formula, symbols_of


@pytest.mark.parametrize(
    ('printed', 'words'),
    [
        # Section IV, with the numbers of its example.
        ('◊[0, 30 s] F', 'eventually[0 s, 30 s] F'),
        ("□[10 s, 20 s] F'", "always[10 s, 20 s] F'"),
        ("F' ∪[0, 5000] F''", "F' until[0 s, 5 s] F''"),
        (
            '□ ∀uav: (power(uav) > M → power(uav) < f · M ∪[0,5000] □[0,3000] power(uav) ≤ M)',
            (
                'always forall uav: (power[uav] > M -> '
                'power[uav] < f * M until[0 s, 5 s] always[0 s, 3 s] power[uav] <= M)'
            ),
        ),
        # Section V.
        (
            '∀x ∈ UAV: x ≠ uav1 → □ XYDist[x, uav1] > 10',
            'forall x in UAV: x != uav1 -> always XYDist[x, uav1] > 10',
        ),
        # Section VIII and figure 8.
        (
            '□ ¬p → ◊[0,1000] □[0,999] p',
            'always not p -> eventually[0 s, 1 s] always[0 s, 999 ms] p',
        ),
    ],
)
def test_formulas_of_the_paper(printed: str, words: str) -> None:
    formula = parse_formula(printed)
    assert formula == parse_formula(words)
    assert str(formula).isascii()
    assert parse_formula(str(formula)) == formula
    FormulaGroup().add_formula('formula', printed)


@pytest.mark.parametrize(
    ('printed', 'message'),
    [
        ('◊[τ1, τ2] F', "1:3: unexpected character 'τ', expected a duration such as 5 s or a num"),
        ("F U[0, τ] □[0, τ'] G", "1:8: unexpected character 'τ', expected 'inf', a duration su"),
        ('F′ and p', "1:2: did you mean 'eventually' instead of 'F'? (unexpected character '′')"),
    ],
)
def test_what_stands_for_a_number_needs_one(printed: str, message: str) -> None:
    with pytest.raises(LanguageError) as error:
        parse_formula(printed)
    assert str(error.value).startswith(f'formula:{message}')


def test_a_sort_that_is_left_out() -> None:
    formula = parse_formula('□ ∀uav: power(uav) > 3 ∧ ∃v: v ≠ uav ∧ near(v, uav)')
    assert str(formula) == (
        'always (forall uav: ((power[uav] > 3) and (exists v: ((v != uav) and near[v, uav]))))'
    )
    assert list(map(str, symbols_of(formula))) == ['?uav', 'power[?uav]', '?v', 'near[?v, ?uav]']
    group = FormulaGroup()
    group.add_formula('formula', str(formula))
    with pytest.raises(ReasoningError, match="'uav' has no sort; write uav in SORT after forall"):
        group.begin({'UAV': ['uav1']})


@pytest.mark.parametrize('name', ['abs', 'min', 'max', 'mean', 'sqrt', 'sum'])
def test_the_names_of_functions(name: str) -> None:
    for text in (f'{name}[a] > 3', f'always {name} < 3'):
        with pytest.raises(LanguageError, match=f"'{name}' is (a function|no function)"):
            parse_formula(text)
    # A field, an object and a longer name are something else.
    for text in (f'a.{name} > 3', f'Power[{name}] > 3', f"{name}' > 3", f'{name}_a > 3'):
        parse_formula(text)
