"""Spatial operators over the links between objects, by hand and at random."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from importlib.util import find_spec
from itertools import accumulate, product
from random import Random
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from reasoning_reference import (
    Trace,
    begun,
    holds,
    progressed,
    progressed_many,
    random_cases,
    with_history,
)
from spatial_reference import OBJECTS
from test_paths import plain, set_limits

from dyknow_common import LanguageError, Verdict
from dyknow_reasoning import (
    FormulaGroup,
    FormulaResult,
    ReasoningError,
    TrialFormula,
    UnknownFeatures,
    parse_formula,
)

DELAUNAY = (
    ('delaunay(N[a], M[a]) and D[a, b] < 9', 'delaunay(N[a], 0) and D[a, b] <= 3')
    if find_spec('shapely')
    else ()
)
LINKS = (
    'L[a, b]',
    'D[a, b] <= 3',
    'L[a, b] and D[a, b] < 4 by D[a, b]',
    *DELAUNAY,
)
HOPS = (
    *('[0, inf)', '[0, 1 hops]', '[0, 2 hops)', '[1, 2 hops]', '(1 hops, inf)', '[2, 2 hops]'),
    *('[0, 0 hops]', '(0 hops, inf)'),
)
LENGTHS = (*HOPS, '[0, 3]', '(1, 4]', '[2.5, 6)', '[3, inf)', '[0, 0]', '(0, inf)', '[0.0, inf)')
STATES = ('P[s]', 'not Q[s]', 'N[s] < 2', '(P[s] or Q[s])', '(P[s] -> N[s] < 1)', 'true', 'P[a0]')
NUMBERS = (0.0, 0.5, 1.0, 2.0, 3.0, 4.0)
PREFIXES = ('', 'always[0, 3 ns] ', 'eventually[1 ns, 4 ns] ', 'once ', 'previous ', 'not ')


def random_text(
    choose: Callable[[Sequence[Any]], Any],
    depth: int,
    *,
    in_time: bool = True,
    states: Sequence[str] = STATES,
) -> str:
    """A formula over links, whose operators nest freely but along routes."""
    link = choose(LINKS)
    distances = HOPS if link == LINKS[0] else LENGTHS

    def body(  # noqa: PLR0911 - one for each kind
        depth: int, *, is_state: bool = not in_time
    ) -> str:
        if not depth or choose(range(5)) == 0:
            return str(choose(states))
        inner = choose(distances)
        match choose(range(4 if is_state else 8)):
            case 0:
                word = choose(['somewhere', 'everywhere'])
                return f'({word}{inner} {body(depth - 1, is_state=is_state)})'
            case 1:
                return f'(escape{inner} {body(depth - 1, is_state=True)})'
            case 2:
                left = body(depth - 1, is_state=True)
                word = choose(['reach', 'reach', 'surround'])
                return f'({left} {word}{inner} {body(depth - 1, is_state=is_state)})'
            case 3:
                word = choose(['and', 'or', '<->'])
                sides = (body(depth - 1, is_state=is_state) for _ in range(2))
                return f'({f" {word} ".join(sides)})'
            case 4 | 5:
                return f'({choose(PREFIXES)}{body(depth - 1)})'
            case 6:
                return f'({body(depth - 1)} until[0, 4 ns] {body(depth - 1)})'
            case _:
                return f'({body(depth - 1)} since {body(depth - 1)})'

    prefix = choose(PREFIXES) if in_time else ''
    return f'{prefix}over ({link} for a, b in R) from a0 to s: {body(depth)}'


@st.composite
def texts(draw: st.DrawFn) -> str:
    return random_text(lambda choices: draw(st.sampled_from(choices)), 3)


@given(texts())
def test_reading_what_was_written(text: str) -> None:
    formula = parse_formula(text)
    assert parse_formula(str(formula)) == formula


@pytest.mark.timeout(14400)
def test_operators_at_one_state(monkeypatch: pytest.MonkeyPatch) -> None:
    """Compare with the reference; most cases by far of all tests."""
    monkeypatch.setitem(OBJECTS, 'R', ())
    for case in range(random_cases(300)):
        random = Random(case)  # noqa: S311 - no secrets
        objects = OBJECTS['R'] = tuple(f'a{number}' for number in range(random.choice((2, 3, 4))))
        pairs = [f'[{a}, {b}]' for a, b in product(objects, objects) if a != b]
        state: dict[str, Any] = {f'L{pair}': random.random() < 0.4 for pair in pairs}
        state |= {f'D{pair}': random.choice(NUMBERS) for pair in pairs}
        for name in objects:
            state |= {f'{feature}[{name}]': random.random() < 0.6 for feature in 'PQ'}
            state |= {f'{feature}[{name}]': random.choice(NUMBERS) for feature in 'NM'}
        text = random_text(random.choice, 3, in_time=False)
        group = started(text)
        (found,) = group.decided_at_once() or group.progress(0, state)
        expected = holds(parse_formula(text), [(0, state)], 0)
        assert (found.verdict is Verdict.TRUE) == expected, (case, text)


@st.composite
def traces(draw: st.DrawFn) -> Trace:
    """States of a few objects and of the links between them."""
    objects = OBJECTS['R']
    numbers = st.sampled_from(NUMBERS)
    columns: dict[str, st.SearchStrategy[Any]] = {}
    for a, b in product(objects, objects):
        if a != b:
            columns |= {f'L[{a}, {b}]': st.booleans(), f'D[{a}, {b}]': numbers}
    for a in objects:
        columns |= {
            f'P[{a}]': st.booleans(),
            f'Q[{a}]': st.booleans(),
            f'N[{a}]': numbers,
            f'M[{a}]': numbers,
        }
    states = draw(st.lists(st.fixed_dictionaries(columns), min_size=1, max_size=6))
    steps = draw(st.lists(st.integers(1, 3), min_size=len(states), max_size=len(states)))
    return list(zip(accumulate(steps), states, strict=True))


@pytest.fixture(params=[1, 3])
def _objects(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(OBJECTS, 'R', tuple(f'a{number}' for number in range(request.param)))


def started(text: str) -> FormulaGroup:
    group, _ = begun(text, OBJECTS)
    return group


@pytest.mark.usefixtures('_objects')
@given(texts(), traces())
def test_verdicts_are_those_of_the_reference(text: str, trace: Trace) -> None:
    formula = parse_formula(text)
    assert parse_formula(str(formula)) == formula
    group = started(text)
    found = group.decided_at_once()
    for length in range(1, len(trace) + 1):
        found = found or group.progress(*trace[length - 1])
        expected = holds(formula, trace[:length], 0)
        if found:
            assert found[0].error is None
            assert expected in {None, found[0].verdict is Verdict.TRUE}
        else:
            assert expected is None


@pytest.mark.usefixtures('_objects')
@given(texts(), traces(), st.data())
def test_gaps_are_sound(text: str, trace: Trace, data: st.DataObject) -> None:
    """The verdict with a gap is that over the states which were missing."""
    first = data.draw(st.integers(1, len(trace)))
    last = data.draw(st.integers(first, len(trace)))
    group = started(text)
    found = group.decided_at_once()
    for index, (time, values) in enumerate(trace):
        if first <= index < last:
            continue
        if index == last and first < last and not found:
            group.gap()
        found = found or group.progress(time, values)
    if found and found[0].error is None:
        expected = holds(parse_formula(text), trace, 0)
        assert expected in {None, found[0].verdict is Verdict.TRUE}


@pytest.mark.usefixtures('_objects')
@given(texts(), traces(), st.sampled_from([None, 'x', float('nan')]), st.data())
def test_all_paths_give_the_same_results(
    text: str, trace: Trace, bad: Any, data: st.DataObject
) -> None:
    text = f'forall r in R: {text.replace("from a0", "from r")}'
    states = [dict(values) for _, values in trace]
    if bad is not None:
        data.draw(st.sampled_from(states))[data.draw(st.sampled_from(sorted(states[0])))] = bad
    times = [time for time, _ in trace]
    found: list[list[FormulaResult]] = []
    for batch, many in product((1, 1000), (0, 1, 2)):
        with pytest.MonkeyPatch.context() as patch:
            set_limits(patch, batch, 1 << 14, 1 << 16)
            group, stated = started(text), list(zip(times, states, strict=True))
            if many == 2 and bad is None:
                results = progressed_many(group, stated)
            elif many:
                columns = {name: [each[name] for each in states] for name in states[0]}
                results = group.progress_many(times, columns)
            else:
                results = progressed(group, stated)
            found.append([plain(each) for each in results])
    assert all(each == found[0] for each in found)


@pytest.mark.usefixtures('_objects')
@given(texts(), traces())
def test_formulas_asked_at_every_state(text: str, trace: Trace) -> None:
    group, number = begun(text, OBJECTS, every_state=True)
    for time, values in trace:
        assert group.progress(time, values) == []
    formula = parse_formula(text)
    expected = [holds(formula, trace, start) for start in range(len(trace))]
    found = group.standing.formulas[number].monitor.counts()
    assert found.fails >= expected.count(False)
    assert found.holds >= expected.count(True)
    assert found.holds + found.fails + found.undecided == len(trace)


DISTANCES = {'12': 40.0, '23': 40.0, '13': 80.0}
VALUES: dict[str, Any] = {
    f'D[r{pair[0]}, r{pair[1]}]': length
    for each, length in DISTANCES.items()
    for pair in (each, each[::-1])
} | {'Base[r1]': True, 'Base[r2]': False, 'Base[r3]': False}
NEAR = 'let D: m in over (D[a, b] <= 50 m for a, b in R) from r3 to s: '


def decided(text: str, **changed: Any) -> FormulaResult:
    group, _ = begun(text, {'R': ['r1', 'r2', 'r3'], 'Other': ['x']})
    (result,) = group.progress(
        0, {**VALUES, **{f'D[r{k[1]}, r{k[2]}]': v for k, v in changed.items()}}
    )
    return result


@pytest.mark.parametrize(
    ('formula', 'reason'),
    [
        ('somewhere[0, 0.1 km] Base[s]', "r3 reaches r1 by r2 (80 m), where 'Base[s]' holds"),
        (
            'somewhere[0, 1 hops] Base[s]',
            "no object in [0, 1 hops] where 'Base[s]' holds; links lead from it to r2, r1".replace(
                'r2, r1', 'r1, r2'
            ),
        ),
        ('not somewhere[0, 2 hops] Base[s]', "r3 reaches r1 by r2 (2 hops), where 'Base[s]' holds"),
        ('everywhere[0, 60 m] not Base[s]', "'not Base[s]' holds at all 2 objects that r3 reaches"),
        ('everywhere[0, inf) not Base[s]', "r1 by r2 (2 hops), where 'not Base[s]' does not hold"),
        (
            'escape[2 hops, inf) not Base[s]',
            "escapes to no object in [2 hops, inf) along 'not Base",
        ),
        ('escape[1 hops, inf) not Base[s]', "r3 escapes to r2 (1 hops), along 'not Base[s]'"),
        ('not Base[s] reach[0, 90 m] Base[s]', "r3 reaches r1 by r2 (80 m), where 'Base[s]' holds"),
        ('Base[s] reach[0, 90 m] Base[s]', 'no link leads from it'),
    ],
)
def test_explanations(formula: str, reason: str) -> None:
    assert reason in decided(f'{NEAR}{formula}').explanation


@pytest.mark.parametrize(
    ('distances', 'is_at_none'),
    [
        ('[0, 0]', True),
        ('[0, 0.0]', True),
        ('[0, 0 m]', True),
        ('[0, 0 hops]', False),
        ('(0, inf)', False),
        ('(0 m, inf)', False),
        ('(0 hops, inf)', True),
        ('[0 km, inf)', True),
    ],
)
def test_distances_are_lengths_without_hops(distances: str, *, is_at_none: bool) -> None:
    text = f'{NEAR}somewhere{distances} Base[s]'
    for each in (text, str(parse_formula(text))):
        (is_true,) = {decided(each, D32=0.0, D21=0.0).verdict is Verdict.TRUE}
        assert is_true == is_at_none, each


def test_the_link_that_is_missing() -> None:
    result = decided(f'{NEAR}somewhere[0, 0.1 km] Base[s]', D21=55.0)
    assert result.explanation == (
        "at 0.000 s, r3 reaches no object in [0, 0.1 km] where 'Base[s]' holds; links lead from it "
        'to r2, and the next is missing, as D[r2, r1] = 55.0'
    )


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('somewhere[0, 5 m] p', 'operators of space need links'),
        ('p surround[0, 15] q', 'operators of space need links'),
        ('over (L[a,b] for a,b in R) from x to s: somewhere[0, 5 m] P[s]', 'the links have none'),
        ('over (L[a,b] for a,b in R) from x to s: somewhere[0, 0] P[s]', "'[0, 0]' measures"),
        ('over (L[a,b] for a,b in R) from x to s: P[s] surround[0, 15] Q[s]', "'[0, 15]' measures"),
        ('over (L[a,b] for a,b in R) from x to s: somewhere[0, 2.5 hops] P[s]', 'whole links'),
        (
            'over (D[a,b]<3 for a,b in R) from x to s: somewhere[2, 5 m] P[s]',
            'both distances a unit',
        ),
        ('over (D[a,b]<3 for a,b in R) from x to s: somewhere[5, 2] P[s]', 'is empty'),
        ('over (L[a,b] for a,b in R) from x to s: (once P[s]) reach[0, 2 hops] P[s]', 'one state'),
        ('over (L[a,b] for a,b in R) from x to s: escape[0, 2 hops] (always P[s])', 'one state'),
        ('over (once L[a,b] for a,b in R) from x to s: P[s]', 'depend on the present state'),
        ('over (L[a,b] and P[s] for a,b in R) from x to s: P[s]', "do not depend on 's'"),
        ('over (L[a,b] by L[b,a] for a,b in R) from x to s: P[s]', 'it must be a'),
        ('let D: m in over (D[a,b]<3 m for a,b in R) from x to s: somewhere[0, 5 kg] P[s]', 'kg'),
    ],
)
def test_wrong_formulas(text: str, message: str) -> None:
    with pytest.raises(LanguageError, match=re.escape(message)):
        FormulaGroup().add_formula('it', text)


def test_wrong_objects_and_lengths() -> None:
    near = 'over (D[a, b] <= 50 for a, b in R)'
    with pytest.raises(ReasoningError, match="'x' is no object of the sort 'R'"):
        decided(f'{near} from x to s: somewhere[0, 1 hops] Base[s]')
    error = decided(f'{near} from r1 to s: somewhere[0, 10] Base[s]', D12=-1.0).error
    assert "'D[r1, r2]' is -1.0; the length of a link cannot be negative" in str(error)


def test_unknown_values_are_errors() -> None:
    text, unknown = f'eventually {NEAR}somewhere[0, 90 m] Base[s]', UnknownFeatures(all_may_be=True)
    group, _ = begun(text, {'R': ['r1', 'r2', 'r3']}, unknown=unknown)
    (result,) = group.progress(0, {**VALUES, 'Base[r1]': None})
    assert "the field 'Base[r1]' holds a value of type NoneType" in str(result.error)


def test_trials_and_later_formulas() -> None:
    """The registers serve formulas that come and go, and proposed states."""
    text = 'once over (D[a, b] <= 50 for a, b in R) from r3 to s: somewhere[0, 90] Base[s]'
    trial = TrialFormula(text, {'R': ['r1', 'r2', 'r3']})
    assert not trial.holds(1, {**VALUES, 'Base[r1]': False})
    assert trial.holds(1, VALUES)
    group = with_history(text, {'R': ['r1', 'r2', 'r3']})
    for time, is_base, verdict in ((0, False, Verdict.FALSE), (1, True, Verdict.TRUE)):
        for later in range(2):
            number = group.add_formula('it', text)
            (result,) = group.progress(10 * time + later, {**VALUES, 'Base[r1]': is_base})
            assert result.verdict is verdict
            group.remove_formula(number)


ROBOTS = ('r1', 'r2', 'r3', 'r4')
NEIGHBOURS = (
    'over (delaunay(X[a], Y[a]) by hypot(X[a] - X[b], Y[a] - Y[b]) for a, b in R) from r1 to s: '
)


def at_places(*places: tuple[float, float]) -> dict[str, Any]:
    found: dict[str, Any] = {f'P[{name}]': name == 'r4' for name in ROBOTS}
    for name, (x, y) in zip(ROBOTS, places, strict=True):
        found |= {f'X[{name}]': x, f'Y[{name}]': y}
    return found


@pytest.mark.skipif(not DELAUNAY, reason='shapely is not installed')
def test_delaunay_neighbours() -> None:
    """r2 and r3 are between r1 and r4, and hide them from each other."""
    state = at_places((0, 0), (4, 1), (4, -1), (8, 0))
    for text, expected in (
        ('somewhere[0, 1 hops] P[s]', False),
        ('somewhere[0, 2 hops] P[s]', True),
        ('somewhere[0, 8] P[s]', False),
        ('somewhere[0, 8.3] P[s]', True),
    ):
        trial = TrialFormula(NEIGHBOURS + text, {'R': ROBOTS})
        assert trial.holds(0, state) is expected, text
    (found,) = result(NEIGHBOURS + 'somewhere[0, 1 hops] P[s]', state)
    assert 'links lead from it to r2, r3' in found.explanation
    (found,) = result(NEIGHBOURS + 'somewhere[0, 1 hops] P[s]', {**state, 'X[r2]': float('inf')})
    assert "'X[r2]' is inf, and so is no position" in str(found.error)


def result(text: str, state: dict[str, Any]) -> Sequence[FormulaResult]:
    group, _ = begun(text, {'R': ROBOTS})
    return group.progress(0, state)


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('over (delaunay(X[a], Y[b]) for a, b in R)', "takes x and y of 'a' alone, not of 'b'"),
        ('over (delaunay(X[a], Y[a]) or L[a, b] for a, b in R)', "unexpected 'or'"),
        ('over (L[a, b] and delaunay(X[a], Y[a]) for a, b in R)', "'delaunay' stands first in the"),
    ],
)
def test_wrong_neighbours(text: str, message: str) -> None:
    with pytest.raises(LanguageError, match=re.escape(message)):
        parse_formula(f'{text} from r1 to s: somewhere[0, 1 hops] P[s]')


def test_lengths_and_places_in_units() -> None:
    text = 'over (delaunay(X[a] + 1 km, Y[a]) by D[a, b] + 3 km for a, b in R) from r1 to s: '
    known = f'let X: m, D: m in {text}somewhere[0, 1 km] P[s]'
    assert 'X[a] + 1000.0' in str(parse_formula(known))
    assert 'by (D[a, b] + 3000.0)' in str(parse_formula(known))
    with pytest.raises(ReasoningError, match="the unit of 'X' is not known"):
        begun(f'{text}somewhere[0, 1 hops] P[s]', {'R': ROBOTS})


@pytest.mark.parametrize(
    ('origins', 'links', 'body'),
    [
        ('exists k', 'true', 'exists NAME in S: ((NAME != k) and (N[NAME] < N[k]))'),
        ('at least 2 k', 'true', 'count(N[NAME] >= N[k] for NAME in S) > 2'),
        ('exists k', 'exists NAME in S: (N[NAME] < N[k])', 's != k'),
        (
            'forall k',
            'true',
            'over (N[x] < N[y] for x, y in S) from k to NAME: (somewhere[0, inf) N[NAME] > N[k])',
        ),
        ('forall k', 'true', 'eventually[0 s, 1 s] (min(N[NAME] for NAME in S) < N[k])'),
    ],
)
def test_a_variable_with_the_name_of_an_object(origins: str, links: str, body: str) -> None:
    text = f'{origins} in S: over ({links} for u, w in S) from k to s: everywhere[0, inf) ({body})'
    for values in product((0, 1, 2), repeat=3):
        found = []
        for name in ('v', 'a', 'b', 'c'):
            group, _ = begun(text.replace('NAME', name), {'S': 'abc'})
            features = {f'N[{each}]': value for each, value in zip('abc', values, strict=True)}
            (result,) = progressed(group, [(time * 10**9, features) for time in (0, 1, 2)])
            found.append((result.verdict, result.decided_at))
        assert found == found[:1] * 4
