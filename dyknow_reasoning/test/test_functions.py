"""Functions of terms: their values, and their results on all paths."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from itertools import product
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from reasoning_reference import begun, progressed, progressed_many, random_cases, started
from test_paths import plain

from dyknow_common import Verdict
from dyknow_reasoning import FormulaResult, ReasoningError, parse_formula
from dyknow_reasoning.execution import instance_pool
from dyknow_reasoning.language.formula import Comparison
from dyknow_reasoning.progression.atoms import evaluate

NO_BIT = 'only whole numbers that are not negative have bits, and places'
NAMES = [f'o{index}' for index in range(30)]


def decided(text: str, **values: Any) -> FormulaResult:
    """The result of a formula at one state."""
    group, _ = begun(text)
    (result,) = group.decided_at_once() or group.progress(0, values)
    return result


@pytest.mark.parametrize(
    ('term', 'values', 'expected'),
    [
        ('abs(x)', {'x': -3.5}, 3.5),
        ('abs(x)', {'x': -(1 << 60) - 1}, (1 << 60) + 1),
        ('min(x, y)', {'x': 2, 'y': 1.5}, 1.5),
        ('min(x, 5, y)', {'x': 7, 'y': 6}, 5),
        ('max(x, y, 1)', {'x': -2, 'y': 0.5}, 1),
        # An extreme is never rounded to another number.
        ('max(x, y)', {'x': (1 << 53) + 1, 'y': 0.5}, (1 << 53) + 1),
        ('min(x, y)', {'x': -(1 << 60) - 1, 'y': 0.5}, -(1 << 60) - 1),
        ('abs(x)', {'x': -(10**400)}, 10**400),
        ('max(x, y)', {'x': 10**400, 'y': 0.5}, 10**400),
        ('sqrt(x)', {'x': 2.25}, 1.5),
        ('hypot(x, y)', {'x': 5, 'y': 12.0}, 13),
        ('hypot(x, y, 12)', {'x': 3, 'y': 4}, 13),
        ('hypot(x, y)', {'x': 3 * 2.0**600, 'y': 4 * 2.0**600}, 5 * 2.0**600),
        ('angle_difference(x, y)', {'x': 3.0, 'y': -3.0}, math.remainder(6.0, math.tau)),
        ('angle_difference(x, 0)', {'x': math.pi}, math.pi),
        ('angle_difference(x, 0)', {'x': -math.pi}, math.pi),
        ('angle_difference(0, x)', {'x': math.pi}, math.pi),
        ('angle_difference(x, y)', {'x': 0.25, 'y': 0.5}, -0.25),
        ('sin(x)', {'x': math.pi / 6}, math.sin(math.pi / 6)),
        ('cos(0)', {}, 1),
        ('atan2(x, y)', {'x': -1, 'y': -1}, -3 * math.pi / 4),
        ('mod(x, 360)', {'x': -90}, 270),
        ('mod(x, 0.5)', {'x': 1.75}, 0.25),
        ('mod(x, 7)', {'x': 10**400}, 10**400 % 7),
        ('bit(x, 3)', {'x': 0b1000}, 1),
        ('bit(x, 0)', {'x': 0b1000}, 0),
        ('bit(x, y)', {'x': (1 << 60) + 2.0**0 - 1, 'y': 60.0}, 1),
        ('bit(x, 64)', {'x': 1 << 64}, 1),
        ('abs(min(x, -x)) * 2', {'x': 3}, 6),
        ('x^2', {'x': -3}, 9),
        ('-x^2', {'x': 3}, -9),
        ('x^-1^2', {'x': 4}, 0.25),
        ('2 * x^y', {'x': 9, 'y': 0.5}, 6),
        ('pow(x, 2)', {'x': math.inf}, math.inf),
    ],
)
def test_values(term: str, values: dict[str, float], expected: float) -> None:
    assert decided(f'{term} = z', z=expected, **values).verdict is Verdict.TRUE


@pytest.mark.parametrize(
    ('term', 'values', 'error'),
    [
        ('sqrt(x)', {'x': -4.0}, "'sqrt(x)' is sqrt(-4.0): a negative number has no square root"),
        (
            'angle_difference(x, 1)',
            {'x': math.inf},
            (
                "'angle_difference(x, 1)' is angle_difference(inf, 1): an infinite angle has no "
                'direction'
            ),
        ),
        (
            'angle_difference(x, x)',
            {'x': math.inf},
            "'angle_difference(x, x)' is angle_difference(inf, inf): not a number",
        ),
        ('sin(x)', {'x': math.inf}, "'sin(x)' is sin(inf): an infinite angle has no direction"),
        (
            'mod(x, 0)',
            {'x': 5},
            "'mod(x, 0)' is mod(5, 0): there is no remainder of a division by zero",
        ),
        *(
            (
                f'bit(x, {place})',
                {'x': flags},
                f"'bit(x, {place})' is bit({flags}, {place}): {NO_BIT}",
            )
            for flags, place in ((1.5, 0), (-1, 0), (1, -1))
        ),
        *(
            (
                f'x^{exponent}',
                {'x': base},
                (
                    f"'pow(x, {exponent})' is pow({base}, {exponent}): zero has no negative power, "
                    'and a negative number no power that is not whole'
                ),
            )
            for base, exponent in ((0, -1), (-8.0, 0.5))
        ),
        (
            'x^9999999999',
            {'x': 10},
            "'pow(x, 9999999999)' is pow(10, 9999999999): the result is too large",
        ),
        (
            'hypot(x, 1)',
            {'x': 10**400},
            f"'hypot(x, 1)' is hypot(1{'0' * 43}…{'0' * 49}, 1): int too large to convert to float",
        ),
    ],
)
def test_no_value_is_an_error(term: str, values: dict[str, float], error: str) -> None:
    result = decided(f'{term} < 1', **values)
    assert result.verdict is Verdict.UNDECIDED
    assert str(result.error) == f'at 0.000 s: {error}'


def test_constants_need_no_state() -> None:
    result = decided('hypot(3, 4) = max(5, 2)')
    assert result.explanation == 'it is true, whatever the states are'


def test_an_explanation() -> None:
    result = decided('hypot(x, y) < 5', x=3.0, y=4.5)
    assert result.explanation == 'hypot(x, y) = 5.40832691 at 0.000 s is not < 5'


CALLS = [
    'abs(A)',
    'min(A, B)',
    'max(A, B, 1)',
    'sqrt(A)',
    'hypot(A, B)',
    'angle_difference(A, B)',
    'sin(A)',
    'cos(A)',
    'atan2(A, B)',
    'mod(A, B)',
    'bit(A, 1)',
    'A^B',
    'A^2',
    'min(A, B) * A',
]
ANY = st.one_of(
    st.floats(allow_nan=False),
    st.floats(-10, 10),
    st.sampled_from([math.pi, -math.pi, 3 * math.pi, -0.0, 0.0, math.inf]),
)


def results_on_all_paths(
    texts: Sequence[str],
    columns: Mapping[str, list[Any]],
    domains: Mapping[str, Sequence[str]] | None = None,
) -> list[list[FormulaResult]]:
    """The results of formulas over columns: by states and by vectors, for one and for many."""
    found = []
    rows = zip(*columns.values(), strict=True)
    trace = [(time, dict(zip(columns, row, strict=True))) for time, row in enumerate(rows)]
    for batch, many in product((1, 1000), (False, True)):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(instance_pool, '_MIN_BATCH_SIZE', batch)
            progress = progressed_many if many else progressed
            results = progress(started(*texts, domains=domains), trace)
            found.append([plain(each) for each in results])
    return found


@settings(max_examples=random_cases(20))
@given(
    st.sampled_from(CALLS),
    st.lists(st.tuples(ANY, ANY), min_size=3, max_size=6),
    st.booleans(),
)
def test_all_paths_agree_to_the_bit(
    call: str,
    values: list[tuple[float, float]],
    whole: bool,  # noqa: FBT001
) -> None:
    """Compare each call with its own value as computed for one state: it equals no other number."""
    exact = []
    for first, second in values:
        state: dict[str, Any] = {'A': first, 'B': second}
        if whole:
            state = {name: int(max(-9, min(9, value))) for name, value in state.items()}
        exact.append((state, value(call, state)))
    texts = [
        f'always {call.replace("A", f"A[{name}]").replace("B", f"B[{name}]")} = C[{name}]'
        for name in NAMES
    ]
    columns = {
        f'{key}[{name}]': [{**state, 'C': result}[key] for state, result in exact]
        for name in NAMES
        for key in 'ABC'
    }
    found = results_on_all_paths(texts, columns)
    assert all(each == found[0] for each in found)
    assert not [each for each in found[0] if each.verdict is Verdict.FALSE]


def value(call: str, state: dict[str, Any]) -> float:
    formula = parse_formula(f'{call} = 0')
    assert isinstance(formula, Comparison)
    try:
        return evaluate(formula.left, state)  # type: ignore[return-value]
    except ReasoningError:
        return 0.0


@pytest.mark.parametrize(
    ('text', 'state'),
    [
        ('X * 1 > 9007199254740992 and X * 1.0 <= 9007199254740992', {'X': (1 << 53) + 1}),
        ('atan2(X, 0.0) < 1 and atan2(X, -0.0) > 3', {'X': 0.0}),
        (
            'once X * 1 > 9007199254740992 and not once X * 1.0 > 9007199254740992',
            {'X': (1 << 53) + 1},
        ),
    ],
)
def test_numbers_that_are_equal_may_give_other_values(text: str, state: dict[str, Any]) -> None:
    group, _ = begun(text)
    (result,) = group.progress(0, state)
    assert result.verdict is Verdict.TRUE
