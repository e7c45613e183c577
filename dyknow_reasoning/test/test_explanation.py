"""The explanations that operators read."""

from __future__ import annotations

import pytest
from reasoning_reference import begun
from test_formula_group import POWER

from dyknow_common import Value
from dyknow_reasoning import FormulaResult, ground_atoms, objects_text, parse_formula


def decided(
    text: str, columns: dict[str, list[Value]], step: int = 100_000_000
) -> FormulaResult | None:
    """The result of a formula over states at 10.0 s, 10.1 s, ..., or with another step."""
    group, _ = begun(text, {'UAV': ['uav1', 'uav2']})
    length = max(len(column) for column in columns.values())
    for index in range(length):
        values = {name: column[index % len(column)] for name, column in columns.items()}
        for result in group.progress(10_000_000_000 + index * step, values):
            assert result.error is None
            return result
    return None


def explained(text: str, columns: dict[str, list[Value]], step: int = 100_000_000) -> str:
    """The explanation of that result."""
    result = decided(text, columns, step)
    return 'UNDECIDED' if result is None else f'{result.verdict.name}: {result.explanation}'


def test_a_surge() -> None:
    columns: dict[str, list[Value]] = {
        'Power[uav1]': [140.0],
        'Power[uav2]': [140.0, 180.0, 190.0, 231.4],
    }
    assert explained(POWER, columns) == (
        'FALSE: for u = uav2: Power[uav2] = 231.4 at 10.300 s is not < 200 '
        'and Power[uav2] = 231.4 at 10.300 s is not <= 150 (until must hold since 10.100 s)'
    )


def test_a_long_rise() -> None:
    columns: dict[str, list[Value]] = {'Power[uav1]': [140.0], 'Power[uav2]': [160.0] * 60}
    assert explained(POWER, columns) == (
        "FALSE: for u = uav2: 'always[0 s, 3 s] (Power[uav2] <= 150)' held at no state in "
        '[10.000 s, 15.000 s]; Power[uav2] = 160.0 at 15.000 s is not <= 150'
    )


MANY = (
    'FALSE: a is false at 10.000 s; b is false at 10.000 s; c is false at 10.000 s; '
    'd is false at 10.000 s; and 2 more'
)


@pytest.mark.parametrize(
    ('text', 'columns', 'expected'),
    [
        ('p', {'p': [True]}, 'TRUE: p is true at 10.000 s'),
        ('not p', {'p': [True]}, 'FALSE: p is true at 10.000 s'),
        ('a = 3', {'a': [4]}, 'FALSE: a = 4 at 10.000 s is not 3'),
        ('3 < a', {'a': [4]}, 'TRUE: a = 4 at 10.000 s is > 3'),
        ('a <= b', {'a': [4], 'b': [3.5]}, 'FALSE: a = 4 at 10.000 s is not <= b = 3.5'),
        ('m != "on"', {'m': ['on']}, 'FALSE: m = "on" at 10.000 s is equal to "on"'),
        ('a * 2 > b', {'a': [4], 'b': [9]}, 'FALSE: a * 2 = 8 at 10.000 s is not > b = 9'),
        (
            'p and q',
            {'p': [False], 'q': [False]},
            'FALSE: p is false at 10.000 s',
        ),
        (
            'p or q',
            {'p': [False], 'q': [False]},
            'FALSE: p is false at 10.000 s; q is false at 10.000 s',
        ),
        (
            'always p',
            {'p': [True, False]},
            'FALSE: p is false at 10.100 s (always must hold since 10.000 s)',
        ),
        (
            'always[0, 250] p',
            {'p': [True] * 4},
            "TRUE: 'p' held at every state in [10.000 s, 10.250 s]",
        ),
        (
            'eventually[100, 250] p',
            {'p': [True, False, False, False]},
            "FALSE: 'p' held at no state in [10.100 s, 10.250 s]",
        ),
        (
            'eventually[0, 200] p',
            {'p': [False] * 4},
            "FALSE: 'p' held at no state in [10.000 s, 10.200 s]; p is false at 10.200 s",
        ),
        (
            'eventually p',
            {'p': [False, True]},
            'TRUE: p is true at 10.100 s (eventually awaited since 10.000 s)',
        ),
        (
            'always (p -> q until r)',
            {'p': [False, True, False], 'q': [True, True, False], 'r': [False]},
            (
                'FALSE: q is false at 10.200 s and r is false at 10.200 s '
                '(until must hold since 10.100 s)'
            ),
        ),
        (
            'not (q until r)',
            {'q': [True, False], 'r': [False]},
            (
                'TRUE: q is false at 10.100 s and r is false at 10.100 s '
                '(not until awaited since 10.000 s)'
            ),
        ),
        (
            'p until[0, 1 s] q',
            {'p': [True], 'q': [False, False, True]},
            'TRUE: q is true at 10.200 s (until awaited since 10.000 s)',
        ),
        (
            'exists u in UAV: P[u]',
            {'P[uav1]': [False], 'P[uav2]': [False]},
            (
                'FALSE: for none of 2 objects of UAV, decided last: '
                'P[uav1] is false at 10.000 s; P[uav2] is false at 10.000 s'
            ),
        ),
        (
            'forall u in UAV: exists v in UAV: exists w in UAV: always P[v] and R[w, u]',
            {
                'P[uav1]': [True, False],
                'P[uav2]': [False],
                **{f'R[uav{i}, uav{j}]': [True] for i in (1, 2) for j in (1, 2)},
            },
            (
                'FALSE: for u = uav1: for none of 4 choices of v in UAV, w in UAV, decided last: '
                'P[uav1] is false at 10.100 s (always must hold since 10.000 s)'
            ),
        ),
        (
            'always[0, 100] forall x in UAV: forall y in UAV: D[x, y] > 10',
            {f'D[uav{i}, uav{j}]': [11] * 3 for i in (1, 2) for j in (1, 2)},
            (
                'TRUE: for all 4 choices of x in UAV, y in UAV, decided last for '
                "x = uav2, y = uav2: 'D[uav2, uav2] > 10' held at every state in "
                '[10.000 s, 10.100 s]'
            ),
        ),
        (
            'exists u in UAV: eventually P[u]',
            {'P[uav1]': [False], 'P[uav2]': [False, True]},
            'TRUE: P[uav2] is true at 10.100 s (eventually awaited since 10.000 s)',
        ),
        (
            'forall u in UAV: eventually P[u]',
            {'P[uav1]': [False, True], 'P[uav2]': [False, False, True]},
            (
                'TRUE: for all 2 objects of UAV, decided last for u = uav2: '
                'P[uav2] is true at 10.200 s (eventually awaited since 10.000 s)'
            ),
        ),
        (
            'forall x in UAV: forall y in UAV: x != y -> always D[x, y] > 10',
            {'D[uav1, uav2]': [11], 'D[uav2, uav1]': [11, 9]},
            (
                'FALSE: for x = uav2, y = uav1: D[uav2, uav1] = 9 at 10.100 s is not > 10 '
                '(always must hold since 10.000 s)'
            ),
        ),
        ('a or b or c or d or e or f', {key: [False] for key in 'abcdef'}, MANY),
        (
            'eventually[100, 200] true and (p or not p)',
            {'p': [True, True]},
            (
                'TRUE: there is a state at 10.100 s '
                '(eventually[100 ms, 200 ms] awaited since 10.000 s)'
            ),
        ),
        (
            'p -> (always q) and eventually not q',
            {'p': [True], 'q': [True]},
            'FALSE: p is true at 10.000 s',
        ),
        # A terminal shows no control character of a value.
        (
            'always m = "ok"',
            {'m': ['a\x1b[31m\x9b\n']},
            r'FALSE: m = "a\u001b[31m\u009b\u000a" at 10.000 s is not "ok"',
        ),
    ],
)
def test_verdicts(text: str, columns: dict[str, list[Value]], expected: str) -> None:
    assert explained(text, columns) == expected


def test_what_remains_shows_no_control_character() -> None:
    group, formula = begun('let k = m in eventually[0 s, 5 s] m != k')
    group.progress(0, {'m': 'a\x1b[31m'})
    assert group.residual(formula) == r'eventually[0 s, 5 s] (m != "a\u001b[31m")'


SECOND = 1_000_000_000


@pytest.mark.parametrize(
    ('text', 'columns', 'step', 'expected'),
    [
        # A window without a state.
        (
            'always[5 s, 6 s] p',
            {'p': [True, False]},
            7 * SECOND,
            'TRUE: there was no state in [15.000 s, 16.000 s]',
        ),
        (
            'eventually[5 s, 6 s] p',
            {'p': [True, True]},
            7 * SECOND,
            'FALSE: there was no state in [15.000 s, 16.000 s]',
        ),
        # A window whose only state is its end, or is before the deciding state.
        (
            'always[5 s, 6 s] p',
            {'p': [False, True]},
            6 * SECOND,
            "TRUE: 'p' held at every state in [15.000 s, 16.000 s]",
        ),
        (
            'eventually[2 s, 3 s] p',
            {'p': [True, False, True]},
            2 * SECOND,
            "FALSE: 'p' held at no state in [12.000 s, 13.000 s]",
        ),
        # Bounds that the interval excludes.
        (
            'eventually(0 s, 1 s] p',
            {'p': [True, False, False]},
            SECOND // 2,
            "FALSE: 'p' held at no state in (10.000 s, 11.000 s]; p is false at 11.000 s",
        ),
        (
            'always[0 s, 1 s) p',
            {'p': [True, True, False]},
            SECOND // 2,
            "TRUE: 'p' held at every state in [10.000 s, 11.000 s)",
        ),
        # Two windows over one body, joined.
        (
            '(always[1 s, 2 s] p) and always[1500, 3 s] p',
            {'p': [False, True, True, True]},
            SECOND,
            "TRUE: 'p' held at every state in [11.000 s, 13.000 s]",
        ),
        # An interval that starts later: the operator does not matter before that.
        (
            'always[2 s, 3 s] p',
            {'p': [False, False, False]},
            SECOND,
            'FALSE: p is false at 12.000 s (always[2 s, 3 s] must hold since 10.000 s)',
        ),
        # An interval that is joined from two, and is neither.
        (
            '(always[1 s, 2 s] p) and always[2 s, 3 s] p',
            {'p': [True, False]},
            SECOND,
            'FALSE: p is false at 11.000 s',
        ),
        # The state is in the interval of an earlier operator only.
        (
            'always (q -> always[1 s, 2 s] p)',
            {'p': [True, True, False], 'q': [True]},
            SECOND * 9 // 10,
            'FALSE: p is false at 11.800 s',
        ),
        # An operator that fails and begins again at one state.
        (
            'eventually (p and (q until r))',
            {'p': [True, True, False], 'q': [True, False, False], 'r': [False, False, True]},
            SECOND,
            'TRUE: r is true at 12.000 s',
        ),
        # Times that differ by less than a millisecond.
        (
            'always p',
            {'p': [True, False]},
            1000,
            'FALSE: p is false at 10.000001 s (always must hold since 10.000 s)',
        ),
        # Values that differ less than their rounded texts.
        (
            'x = 0.3',
            {'x': [0.1 + 0.2]},
            1,
            'FALSE: x = 0.30000000000000004 at 10.000 s is not 0.3',
        ),
        (
            '0.3 >= x',
            {'x': [0.1 + 0.2]},
            1,
            'FALSE: x = 0.30000000000000004 at 10.000 s is not <= 0.3',
        ),
        (
            'x < y',
            {'x': [0.3], 'y': [0.1 + 0.2]},
            1,
            'TRUE: x = 0.3 at 10.000 s is < y = 0.30000000000000004',
        ),
        (
            'x <= 0.29',
            {'x': [0.2899999999999]},
            1,
            'TRUE: x = 0.2899999999999 at 10.000 s is <= 0.29',
        ),
        ('x < 1', {'x': [0.1 + 0.2]}, 1, 'TRUE: x = 0.3 at 10.000 s is < 1'),
        (
            'x + y > 0.3',
            {'x': [0.1], 'y': [0.2]},
            1,
            'TRUE: x + y = 0.30000000000000004 at 10.000 s is > 0.3',
        ),
        (
            '0.1 + 0.2 <= x',
            {'x': [0.3]},
            1,
            'FALSE: 0.1 + 0.2 = 0.30000000000000004 at 10.000 s is not <= x = 0.3',
        ),
        # An empty window with open bounds, and one that is due.
        (
            'eventually(2 s, 5 s] p',
            {'p': [False, True]},
            6 * SECOND,
            'FALSE: there was no state in (12.000 s, 15.000 s]',
        ),
        (
            'always (q -> eventually(1 s, 2 s) p)',
            {'p': [True], 'q': [True, True]},
            3 * SECOND,
            'FALSE: there was no state in (11.000 s, 12.000 s)',
        ),
        # The side of until that failed: the right one in time, the left one before, or both.
        (
            'p until[0, 2 s] q',
            {'p': [True], 'q': [False] * 3},
            SECOND,
            "FALSE: 'q' held at no state in [10.000 s, 12.000 s]; q is false at 12.000 s",
        ),
        (
            'p until[3 s, 5 s] q',
            {'p': [True, False], 'q': [False]},
            SECOND,
            'FALSE: p is false at 11.000 s (until[3 s, 5 s] must hold since 10.000 s)',
        ),
        (
            'p until[0, 5 s] q',
            {'p': [True, False], 'q': [False]},
            SECOND,
            (
                'FALSE: p is false at 11.000 s and q is false at 11.000 s '
                '(until must hold since 10.000 s)'
            ),
        ),
        (
            'not (p until q)',
            {'p': [True, False], 'q': [False]},
            SECOND,
            (
                'TRUE: p is false at 11.000 s and q is false at 11.000 s '
                '(not until awaited since 10.000 s)'
            ),
        ),
        # Decided by what is left of two parts together, whose truth is open.
        (
            '(always[1 s, inf] p) or (q and eventually not p)',
            {'p': [True], 'q': [True]},
            1,
            "TRUE: '(eventually (not p)) or (always[1 s, inf] p)' is true whatever states follow",
        ),
        (
            'always[0, 2 ns] ((always[1 s, inf] p) and (q -> eventually[2 s, inf] not p))',
            {'p': [True], 'q': [False, True]},
            1,
            (
                "FALSE: '(eventually[2 s, inf] (not p)) and (always[1 s, inf] p)' is false "
                'whatever states follow (always must hold since 10.000 s)'
            ),
        ),
    ],
)
def test_no_claim_is_untrue(
    text: str, columns: dict[str, list[Value]], step: int, expected: str
) -> None:
    assert explained(text, columns, step) == expected


@pytest.mark.parametrize(
    ('text', 'values', 'objects', 'windows', 'decided_at'),
    [
        # The whole window of the obligation, though a state within it decided.
        (POWER, [140.0, 180.0, 190.0, 231.4], 'u = uav2', [(10.1, 15.1)], 10.3),
        (POWER, [160.0] * 60, 'u = uav2', [(10.0, 15.0)], 15.0),
        ('eventually[200 ms, 500 ms] Power[uav2] > 5', [1, 9, 1, 9], '', [(10.2, 10.5)], 10.3),
        # Without an end, to the deciding state.
        ('always Power[uav2] < 5', [1, 2, 9], '', [(10.0, 10.2)], 10.2),
        ('Power[uav2] < 5', [9], '', [], 10.0),
    ],
)
def test_the_windows_and_objects_of_a_verdict(
    text: str,
    values: list[Value],
    objects: str,
    windows: list[tuple[float, float]],
    decided_at: float,
) -> None:
    result = decided(text, {'Power[uav1]': [140.0], 'Power[uav2]': values})
    assert result is not None
    assert (result.objects, result.decided_at) == (objects, round(decided_at * 1e9))
    assert [(start / 1e9, end / 1e9) for start, end in result.windows] == windows


def test_the_atoms_of_each_instance_are_those_of_the_text() -> None:
    formula = parse_formula(
        'forall u in S: always (u != a -> (exists v in T: F[u, v] >= 2 * G[u]) and p and p)'
    )
    found = ground_atoms(formula, {'S': ['a', 'b'], 'T': ['c', 'd']})
    assert [(objects_text(binding), list(map(str, atoms))) for binding, atoms in found] == [
        ('u = a', ['a != a', 'F[a, c] >= (2 * G[a])', 'F[a, d] >= (2 * G[a])', 'p']),
        ('u = b', ['b != a', 'F[b, c] >= (2 * G[b])', 'F[b, d] >= (2 * G[b])', 'p']),
    ]
