"""The texts of what remains of formulas are in the words of the formulas."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import NAMES, begun, formulas, holds

from dyknow_common import Value
from dyknow_reasoning import parse_formula
from dyknow_reasoning.explanation.remainders import Remainders
from dyknow_reasoning.language.formula import Formula
from dyknow_reasoning.progression.residual import remaining_text

SECOND = 10**9
STATE: dict[str, Value] = {'p': True, 'q': False, 'r': True, 'x': 1.0, 'y': 7.0}


@pytest.mark.parametrize(
    ('formula', 'residual'),
    [
        (
            'always (p -> eventually[0 s, 5 s] q)',
            '(always (p -> (eventually[0 s, 5 s] q))) and (eventually[0 s, 4 s] q)',
        ),
        ('always (p and q -> r)', 'always ((p and q) -> r)'),
        ('always (not p or q -> r)', 'always (((not p) or q) -> r)'),
        ('always (q <-> not p)', 'always (q <-> (not p))'),
        ('always not (p and q)', 'always (not (p and q))'),
        ('not eventually (p and q)', 'not (eventually (p and q))'),
        ('not eventually[0 s, 5 s] (p and q)', 'always[0 s, 4 s] (not (p and q))'),
        ('not (p until q)', 'not (p until q)'),
        ('not ((p -> r) until q)', 'not ((p -> r) until q)'),
        ('p unless q', 'p unless q'),
        ('p unless[0 s, 5 s] q', 'p unless[0 s, 4 s] q'),
        (
            'always (r -> p unless[0 s, 5 s] q)',
            (
                '((always (r -> (p unless[0 s, 5 s] q))) and (p unless[0 s, 4 s] q)) and '
                '(p unless[0 s, 5 s] q)'
            ),
        ),
        ('p holds until[0 s, 5 s] q', 'p holds until[0 s, 4 s] q'),
        ('p until q', 'p until q'),
        ('q release[0 s, 5 s] p', 'q release[0 s, 4 s] p'),
        ('always (p release r)', 'always (p release r)'),
        ('always x > -3', 'always (x > -3)'),
        ('let x: m/s in always (p -> x < 4 km/h)', 'always (p -> (x < 4 km/h))'),
        ('let x: m/s in always x < 4 km/h', 'always (x < 4 km/h)'),
        ('let x: m/s in eventually[0 s, 3 s] x < -4 km/h', 'eventually[0 s, 2 s] (x < -4 km/h)'),
        ('always (x < 5 -> y != 6)', 'always ((x < 5) -> (y != 6))'),
        ('always exists u in S: P[u]', 'always (exists u in S: P[u])'),
        ('always at most 1 u in S: P[u]', 'always (at most 1 u in S: P[u])'),
        (
            'forall u in S: always (Q[u] -> exists v in S: P[v])',
            '(always (Q[a] -> (exists v in S: P[v]))) and (always (Q[b] -> (exists v in S: P[v])))',
        ),
    ],
)
def test_what_remains_after_a_second(formula: str, residual: str) -> None:
    group, number = begun(formula, {'S': ['a', 'b']})
    objects = {'P[a]': True, 'P[b]': False, 'Q[a]': True, 'Q[b]': False}
    for second in range(2):
        assert group.progress(second * SECOND, {**STATE, **objects}) == []
    assert group.residual(number) == residual
    parse_formula(residual)


states = st.fixed_dictionaries({name: st.booleans() for name in NAMES})


@given(formulas(3), st.lists(states, min_size=1, max_size=4), st.lists(states, max_size=5))
def test_the_words_say_what_remains(
    formula: Formula, seen: list[dict[str, bool]], more: list[dict[str, bool]]
) -> None:
    group, number = begun(str(formula))
    for time, values in enumerate(seen):
        group.progress(time, values)
    if number not in group.undecided:
        return
    monitor = group._monitor
    assert monitor is not None
    (state,) = Remainders(monitor)._of(number)
    plain = remaining_text(state.node, state.times, len(seen) - 1, state.instance.atoms)
    trace = list(enumerate([seen[-1], *more]))
    said, known = parse_formula(group.residual(number)), parse_formula(plain)
    # The latest state belongs to the operators that hold now, and is past for the others.
    if not any(word in group.residual(number) for word in ('holds until', 'unless', 'release')):
        # A side that simplification has decided is unknown to the reference.
        assert len({holds(said, trace, 0), holds(known, trace, 0)} - {None}) < 2
