"""A slow, obvious reading of the semantics, with formulas and groups to compare it with."""

from __future__ import annotations

import operator
import os
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields
from typing import Any, get_args

import numpy as np
from hypothesis import strategies as st

from dyknow_common import Value
from dyknow_reasoning import FormulaGroup, FormulaLimits, FormulaResult, UnknownFeatures
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
    CountBound,
    CountOf,
    Equivalent,
    Eventually,
    Formula,
    Freeze,
    Historically,
    Implies,
    Interval,
    Not,
    Once,
    Or,
    PastFormula,
    Previous,
    Since,
    Until,
)
from dyknow_reasoning.language.terms import (
    Arithmetic,
    Feature,
    FieldReference,
    Kept,
    StateCount,
    Truth,
    ValueBefore,
)

NAMES = ('p', 'q')

COMPARISONS: Mapping[str, Any] = {
    '=': operator.eq,
    '!=': operator.ne,
    '<': operator.lt,
    '<=': operator.le,
    '>': operator.gt,
    '>=': operator.ge,
}

Trace = Sequence[tuple[int, Mapping[str, Value]]]


def random_cases(usual: int) -> int:
    """The number of random cases of a test, unless the run has another one."""
    return int(os.environ.get('DYKNOW_RANDOM_CASES', '0')) or usual


def started(
    *texts: str,
    domains: Mapping[str, Sequence[str]] | None = None,
    limits: FormulaLimits | None = None,
    unknown: UnknownFeatures | None = None,
    **asked: bool,
) -> FormulaGroup:
    """A group of formulas, named by their texts, that waits for its first state."""
    group = FormulaGroup(limits or FormulaLimits())
    for text in texts:
        group.add_formula(text, text, **asked)
    group.begin(domains or {}, unknown or UnknownFeatures())
    return group


def begun(
    text: str,
    domains: Mapping[str, Sequence[str]] | None = None,
    *,
    limits: FormulaLimits | None = None,
    unknown: UnknownFeatures | None = None,
    **asked: bool,
) -> tuple[FormulaGroup, int]:
    """A group of one formula that waits for its first state, and the number of the formula."""
    group = FormulaGroup(limits or FormulaLimits())
    number = group.add_formula('it', text, **asked)
    group.begin(domains or {}, unknown or UnknownFeatures())
    return group, number


def with_history(
    text: str,
    domains: Mapping[str, Sequence[str]] | None = None,
    *,
    limits: FormulaLimits | None = None,
    unknown: UnknownFeatures | None = None,
) -> FormulaGroup:
    """A group without a formula, which remembers what one that comes later looks back to."""
    group = started(domains=domains, limits=limits, unknown=unknown)
    group.keep_history(text)
    return group


def progressed(group: FormulaGroup, trace: Trace) -> list[FormulaResult]:
    """The results of states that come one by one."""
    return [result for time, values in trace for result in group.progress(time, values)]


def progressed_many(group: FormulaGroup, trace: Trace) -> list[FormulaResult]:
    """The results of the same states as columns."""
    names = trace[0][1] if trace else ()
    columns = {name: np.array([values[name] for _, values in trace]) for name in names}
    return group.progress_many([time for time, _ in trace], columns)


def disjunction(values: Iterable[bool | None]) -> bool | None:
    """Or of what may be unknown."""
    seen = set(values)
    if True in seen:
        return True
    return None if None in seen else False


def negation(value: bool | None) -> bool | None:  # noqa: FBT001
    return None if value is None else not value


def conjunction(values: Iterable[bool | None]) -> bool | None:
    return negation(disjunction(negation(value) for value in values))


def comparable(results: Iterable[FormulaResult]) -> list[Any]:
    """What results say, of which errors are no equal objects."""
    return [
        (each.formula_id, each.verdict, each.decided_at, each.explanation, str(each.error))
        for each in results
    ]


def holds(formula: Formula, trace: Trace, i: int) -> bool | None:  # noqa: C901, PLR0911, PLR0912
    """The truth of a formula at a state of a trace that may go on; None while unknown."""
    match formula:
        case Truth(value):
            return value
        case Feature():
            return trace[i][1][str(formula)] is True
        case Comparison(symbol, left, right):
            sides = [past_value_of(each, trace, i) for each in (left, right)]
            return None not in sides and bool(COMPARISONS[symbol](*sides))
        case Not(body):
            return negation(holds(body, trace, i))
        case And(left, right):
            return conjunction([holds(left, trace, i), holds(right, trace, i)])
        case Or(left, right):
            return disjunction([holds(left, trace, i), holds(right, trace, i)])
        case Implies(left, right):
            return disjunction([negation(holds(left, trace, i)), holds(right, trace, i)])
        case Equivalent(left, right):
            sides = [holds(left, trace, i), holds(right, trace, i)]
            return None if None in sides else sides[0] == sides[1]
        case Eventually(body, interval):
            return holds(Until(Truth(True), body, interval), trace, i)
        case Always(body, interval):
            return negation(holds(Eventually(Not(body), interval), trace, i))
        case CountOf(bound, number, members):
            return counted(bound, number, [holds(each, trace, i) for each in members])
        case Until(left, right, interval):
            return until(left, right, interval, trace, i)
        case Once(body, interval):
            return holds(Since(Truth(True), body, interval), trace, i)
        case Historically(body, interval):
            return negation(holds(Once(Not(body), interval), trace, i))
        case Previous(body):
            return holds(body, trace, i - 1) if i else False
        case Since(left, right, interval):
            return since(left, right, interval, trace, i)
        case Freeze(name, term, body):
            outer = dict(KEPT)
            KEPT[name] = past_value_of(term, trace, i)
            found = holds(body, trace, i)
            KEPT.clear()
            KEPT.update(outer)
            return found
    if (spatial := SPATIAL.get(type(formula))) is not None:
        return spatial(formula, trace, i)
    raise AssertionError(formula)


KEPT: dict[str, Any] = {}
"""The values of names, within the formulas of `let`."""

SPATIAL: dict[type, Any] = {}
"""The truth of spatial operators, from `spatial_reference`."""


def counted(bound: CountBound, number: int, values: Sequence[bool | None]) -> bool | None:
    """At least, at most or exactly a number of what may be unknown."""
    fewest = sum(value is True for value in values)
    most = sum(value is not False for value in values)
    enough = True if fewest >= number else None if most >= number else False
    few = True if most <= number else None if fewest <= number else False
    match bound:
        case CountBound.AT_LEAST:
            return enough
        case CountBound.AT_MOST:
            return few
        case CountBound.EXACTLY:
            return conjunction([enough, few])


def value_of(term: Any, values: Mapping[str, Value]) -> Any:
    return values[str(term)] if isinstance(term, Feature | FieldReference) else term.value


def past_value_of(term: Any, trace: Trace, i: int) -> Any:
    """The value of a term at a state; None if it needs a state before the first one."""
    match term:
        case ValueBefore(body):
            return past_value_of(body, trace, i - 1) if i else None
        case StateCount(body, interval):
            first = trace[i][0] - (interval.end or 0)
            return sum(holds(body, trace, j) is True for j in range(i + 1) if trace[j][0] >= first)
        case Kept(name):
            return KEPT[name]
        case Arithmetic('-', left, right):
            sides = [past_value_of(each, trace, i) for each in (left, right)]
            return None if None in sides else sides[0] - sides[1]
        case _:
            return value_of(term, trace[i][1])


def until(left: Formula, right: Formula, interval: Interval, trace: Trace, i: int) -> bool | None:
    begin = trace[i][0]
    end = float('inf') if interval.end is None else begin + interval.end
    cases = [
        conjunction([holds(right, trace, j), *(holds(left, trace, k) for k in range(i + 1, j))])
        for j in range(i, len(trace))
        if begin + interval.start <= trace[j][0] <= end
    ]
    if trace[-1][0] < end:
        cases.append(
            conjunction([None, *(holds(left, trace, k) for k in range(i + 1, len(trace)))])
        )
    return disjunction(cases)


def since(left: Formula, right: Formula, interval: Interval, trace: Trace, i: int) -> bool | None:
    now = trace[i][0]
    end = float('inf') if interval.end is None else interval.end
    return disjunction(
        conjunction([holds(right, trace, j), *(holds(left, trace, k) for k in range(j + 1, i))])
        for j in range(i + 1)
        if interval.start <= now - trace[j][0] <= end
    )


def intervals() -> st.SearchStrategy[Interval]:
    bounds = st.integers(0, 8)
    bounded = st.tuples(bounds, bounds).map(lambda pair: Interval(min(pair), max(pair)))
    return st.one_of(bounded, bounds.map(Interval), st.just(Interval()))


def of_present_and_future(inner: st.SearchStrategy[Formula]) -> list[st.SearchStrategy[Formula]]:
    """Connectives, counts and operators of the future."""
    connectives = [st.builds(kind, inner, inner) for kind in (And, Or, Implies, Equivalent)]
    temporal = [st.builds(kind, inner, intervals()) for kind in (Always, Eventually)]
    members = st.lists(inner, min_size=1, max_size=4).map(tuple)
    count = st.builds(CountOf, st.sampled_from(CountBound), st.integers(0, 4), members)
    until = st.builds(Until, inner, inner, intervals())
    return [st.builds(Not, inner), count, *connectives, *temporal, until]


def deeper(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    operands = st.tuples(inner, inner)
    past = [
        st.builds(past_operator, st.just(kind), operands, intervals())
        for kind in get_args(PastFormula)
    ]
    return st.one_of(*of_present_and_future(inner), *past)


def past_operator(
    kind: type[PastFormula], operands: Iterable[Formula], interval: Interval
) -> PastFormula:
    """A formula with as many of the operands as the operator has."""
    rest = iter(operands)
    names = [each.name for each in fields(kind) if each.name != 'position']
    return kind(*(interval if name == 'interval' else next(rest) for name in names))


LEAVES: st.SearchStrategy[Formula] = st.one_of(
    st.sampled_from(NAMES).map(Feature),
    st.sampled_from(NAMES).map(Feature),
    st.booleans().map(Truth),
)


def formulas(
    depth: int = 4, leaves: st.SearchStrategy[Formula] = LEAVES
) -> st.SearchStrategy[Formula]:
    found = leaves
    for _ in range(depth):
        found = st.one_of(leaves, deeper(found))
    return found
