"""The formula language: what texts mean, how formulas are written, what is said of wrong ones."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import NANOSECONDS, LanguageError, TextPosition
from dyknow_reasoning import FormulaGroup, parse_formula
from dyknow_reasoning.language.formula import (
    Always,
    And,
    Comparison,
    Equivalent,
    Eventually,
    Exists,
    Forall,
    Formula,
    Implies,
    Interval,
    Not,
    Or,
    Until,
    walk,
)
from dyknow_reasoning.language.terms import (
    Arithmetic,
    Feature,
    FieldReference,
    Number,
    Object,
    Term,
    TextLiteral,
    Truth,
    Variable,
)

BAD_FORMULAS = sorted((Path(__file__).parent / 'bad_formulas').glob('*.formula'))

S = 1_000_000_000


def canonical(text: str) -> str:
    return str(parse_formula(text))


def test_relations_of_space_compare_distances() -> None:
    text = 'forall u in UAV, z in Zone: always not inside(u, z) or crosses[u, z]'
    distance, swept = (
        Comparison('<=', Feature(name, (Variable('u'), Variable('z'))), Number(0))
        for name in ('distance', 'swept_distance')
    )
    assert parse_formula(text) == Forall(
        'u', 'UAV', Forall('z', 'Zone', Always(Or(Not(distance), swept)))
    )
    assert canonical('exists u in UAV: inside[u]') == 'exists u in UAV: inside[u]'


def test_power_formula_of_the_paper() -> None:
    normal = Comparison('<=', Feature('Power', (Variable('u'),)), Number(150))
    raised = Comparison('>', Feature('Power', (Variable('u'),)), Number(150))
    bearable = Comparison('<', Feature('Power', (Variable('u'),)), Number(200))
    until = Until(bearable, Always(normal, Interval(0, 3 * S)), Interval(0, 5 * S))
    assert parse_formula(
        'forall u in UAV: always (Power[u] > 150 -> '
        'Power[u] < 200 until[0 s, 5 s] always[0 s, 3 s] Power[u] <= 150)'
    ) == Forall('u', 'UAV', Always(Implies(raised, until)))


def test_distance_formula_of_the_paper() -> None:
    distance = Comparison('>', Feature('XYDist', (Variable('x'), Object('uav1'))), Number(10))
    others = Comparison('!=', Variable('x'), Object('uav1'))
    assert parse_formula('forall x in UAV: x != uav1 -> always XYDist[x, uav1] > 10') == Forall(
        'x', 'UAV', Implies(others, Always(distance))
    )


@pytest.mark.parametrize(
    'text',
    [
        'always not p -> eventually[0,1000] always[0,999] p',
        '□ ¬p → ◇[0,1000] □[0,999] p',
        'always ((not p) -> (eventually[0 s, 1 s] (always[0 s, 999 ms] p)))',
    ],
)
def test_response_formula_of_the_paper(text: str) -> None:
    p = Feature('p')
    period = Eventually(Always(p, Interval(0, 999_000_000)), Interval(0, S))
    assert parse_formula(text) == Always(Implies(Not(p), period))


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('not p until q', '(not p) until q'),
        ('not p and q', '(not p) and q'),
        ('p until q and r', '(p until q) and r'),
        ('p and q or r', '(p and q) or r'),
        ('p or q and r', 'p or (q and r)'),
        ('p or q -> r', '(p or q) -> r'),
        ('p -> q <-> r', '(p -> q) <-> r'),
        ('p -> q -> r', 'p -> (q -> r)'),
        ('p <-> q <-> r', '(p <-> q) <-> r'),
        ('p and q and r', '(p and q) and r'),
        ('p until q until r', 'p until (q until r)'),
        ('p and always q or r', 'p and (always (q or r))'),
        ('not always p -> q', 'not (always (p -> q))'),
        ('p until eventually q and r', 'p until (eventually (q and r))'),
        ('p or forall x in S: q and r', 'p or (forall x in S: (q and r))'),
        ('(always p) and q', '(always p) and q'),
        ('not a = b', 'not (a = b)'),
        ('a + b * c - d < 1', '((a + (b * c)) - d) < 1'),
        ('-a / 2 > -3', '((0 - a) / 2) > -3'),
        ('a - -3 > 0', '(a - -3) > 0'),
    ],
)
def test_precedence(text: str, expected: str) -> None:
    assert canonical(text) == expected


@pytest.mark.parametrize(
    ('symbols', 'words'),
    [
        ('∀ u ∈ UAV: □ P[u] ≥ 3', 'forall u in UAV: always P[u] >= 3'),
        ('∃ u ∈ UAV: ◇ P[u] ≤ 3', 'exists u in UAV: eventually P[u] <= 3'),
        ('¬p ∧ q ∨ r', 'not p and q or r'),  # noqa: RUF001
        ('p → q ↔ r', 'p -> q <-> r'),
        ('a ≠ 3 U[0, ∞] b', 'a != 3 until[0, inf] b'),
        ('XYDist(a, b) > 3', 'XYDist[a, b] > 3'),
    ],
)
def test_both_spellings(symbols: str, words: str) -> None:
    assert parse_formula(symbols) == parse_formula(words)


@pytest.mark.parametrize(
    ('text', 'start', 'end'),
    [
        ('[0, 5 s]', 0, 5 * S),
        ('[500, 1000]', S // 2, S),
        ('[0.5s, 1 min]', S // 2, 60 * S),
        ('[1 us, 2h]', 1000, 7200 * S),
        ('[0, inf]', 0, None),
        ('[3 ns, inf)', 3, None),
        ('[0, 5 s)', 0, 5 * S - 1),
        ('(0, 5 s]', 1, 5 * S),
        ('(0, 5 s)', 1, 5 * S - 1),
        ('[2 s, 2 s]', 2 * S, 2 * S),
    ],
)
def test_intervals(text: str, start: int, end: int | None) -> None:
    interval = Interval(start, end)
    p, q = Feature('p'), Feature('q')
    assert parse_formula(f'always{text} p') == Always(p, interval)
    assert parse_formula(f'eventually {text} (p)') == Eventually(p, interval)
    assert parse_formula(f'p until{text} q') == Until(p, q, interval)


@pytest.mark.parametrize('unit', NANOSECONDS)
def test_all_units_of_time(unit: str) -> None:
    assert canonical(f'always[0, 5.0 {unit}] p') == canonical(
        f'always[0, {5 * NANOSECONDS[unit]} ns] p'
    )


def test_a_round_bracket_may_open_a_formula() -> None:
    assert canonical('always (5 < a) and p') == 'always ((5 < a) and p)'
    assert canonical('p until (5 < a)') == 'p until (5 < a)'


def test_references() -> None:
    field = FieldReference('uav1_power', 'power')
    quoted = FieldReference('/uav1/battery', 'cell.voltage')
    assert parse_formula('uav1_power.power > 3') == Comparison('>', field, Number(3))
    assert parse_formula('"/uav1/battery".cell.voltage') == quoted
    assert parse_formula('"uav1".in.until') == FieldReference('uav1', 'in.until')
    assert str(quoted) == '"/uav1/battery".cell.voltage'
    assert canonical('"uav1".in') == 'uav1.in'


def test_references_to_elements_of_arrays() -> None:
    assert parse_formula('scan.ranges[0]') == FieldReference('scan', 'ranges[0]')
    assert parse_formula('"/cloud".points[12].x[3]') == FieldReference('/cloud', 'points[12].x[3]')
    formula = parse_formula('Power[u] < "/scan".ranges[0] until[0, 5] scan.ranges[1] = 2')
    assert str(formula) == '(Power[u] < "/scan".ranges[0]) until[0 s, 5 ms] (scan.ranges[1] = 2)'
    for text in ('scan.ranges[a b] < 1', 'Power[0] < 1', 'scan.ranges[-0] < 1', 'scan.x[01] < 1'):
        with pytest.raises(LanguageError):
            parse_formula(text)


@pytest.mark.parametrize(
    ('text', 'name', 'expected'),
    [
        ('a = 3', 'a', Feature),
        ('mode = "on"', 'mode', Feature),
        ('mode = other', 'other', Feature),
        ('forall x in S: x = home', 'home', Object),
        ('Dist[home] > 3 and home != base', 'base', Object),
        ('a = b and b = c and P[c]', 'a', Object),
        ('forall x in S: x = a', 'x', Variable),
        ('orbit > 3 and inf = 1 and s = 2', 'orbit', Feature),
    ],
)
def test_names(text: str, name: str, expected: type) -> None:
    formula = parse_formula(text)
    found = {type(term) for term in terms_of(formula) if getattr(term, 'name', '') == name}
    assert found == {expected}


def terms_of(formula: Formula) -> list[Term]:
    match formula:
        case Comparison(_, left, right):
            return [left, right]
        case And(left, right):
            return terms_of(left) + terms_of(right)
        case Forall(_, _, body):
            return terms_of(body)
        case _:
            return []


def test_places() -> None:
    formula = parse_formula('p and\n  always Power[u] > 3')
    assert isinstance(formula, And)
    assert isinstance(formula.right, Always)
    assert formula.right.position == TextPosition(2, 3)
    assert formula.right.body.position == TextPosition(2, 10)


@pytest.mark.parametrize('path', BAD_FORMULAS, ids=lambda path: path.stem)
def test_bad_formulas(path: Path) -> None:
    with pytest.raises(LanguageError) as error:
        FormulaGroup().add_formula('bad', path.read_text(encoding='utf-8'))
    assert f'{error.value}\n' == path.with_suffix('.expected').read_text(encoding='utf-8')


def test_bad_formulas_are_found() -> None:
    assert len(BAD_FORMULAS) > 30


names = st.sampled_from(['p', 'Power', "F'", "true''", 'inf', 's', 'always_', 'U2'])
objects = st.sampled_from(['uav1', 'home']).map(Object)
variables = st.sampled_from(['x', 'y']).map(Variable)
features = st.one_of(
    names.map(Feature),
    st.builds(Feature, names, st.lists(objects | variables, min_size=1, max_size=3).map(tuple)),
)
references = st.builds(
    FieldReference,
    st.sampled_from(['a', '/uav1/power', 'true']),
    st.sampled_from(['b', 'c.in.d', 'e[2].f[0]']),
)
numbers = st.one_of(
    st.integers(), st.floats(allow_nan=False, allow_infinity=False).filter(bool)
).map(Number)
# No control characters.
texts = st.text(st.characters(min_codepoint=0x20, codec='utf-8'), max_size=5).map(TextLiteral)
leaves = st.one_of(numbers, texts, st.booleans().map(Truth), features, references)
terms = st.recursive(
    leaves, lambda inner: st.builds(Arithmetic, st.sampled_from('+-*/'), inner, inner), max_leaves=4
)
operators = st.sampled_from(['=', '!=', '<', '<=', '>', '>='])
atoms = st.one_of(
    st.booleans().map(Truth),
    features,
    references,
    st.builds(Comparison, operators, terms, terms),
    st.builds(Comparison, st.sampled_from(['=', '!=']), variables, variables | objects),
)
bounds = st.integers(0, 10**12)
intervals = st.one_of(
    st.just(Interval()),
    bounds.map(Interval),
    st.tuples(bounds, bounds).map(lambda pair: Interval(min(pair), max(pair))),
)


def deeper(inner: st.SearchStrategy[Formula]) -> st.SearchStrategy[Formula]:
    quantified = [
        st.builds(kind, st.sampled_from(['x', 'y']), st.just('UAV'), inner)
        for kind in (Forall, Exists)
    ]
    return st.one_of(
        *(st.builds(kind, inner, inner) for kind in (And, Or, Implies, Equivalent)),
        *(st.builds(kind, inner, intervals) for kind in (Always, Eventually)),
        *quantified,
        inner.map(Not),
        st.builds(Until, inner, inner, intervals),
    )


def closed(formula: Formula) -> Formula:
    """With all variables bound, so that names are what they were built as."""
    return Forall('x', 'UAV', Exists('y', 'UAV', formula))


@given(st.recursive(atoms, deeper, max_leaves=8).map(closed))
def test_reading_what_was_written(formula: Formula) -> None:
    assert parse_formula(str(formula)) == formula
    assert canonical(str(formula)) == str(formula)


@pytest.mark.parametrize(
    ('text', 'mistake', 'meant'),
    [
        ('alway p', 'alway', 'always'),
        ('G p', 'G', 'always'),
        ('F[0 s, 5 s] p', 'F', 'eventually'),
        ('p && q', '&&', 'and'),
        ('p || q', '||', 'or'),
        ('not !p', '!', 'not'),
        ('x == 1', '==', '='),
        ('p => q', '=>', "->' or '>="),
        ('x => 3', '=>', "->' or '>="),
        ('p untill[0 s, 5 s] q', 'untill', 'until'),
        ('p S q', 'S', 'since'),
        ('p W[0 s, 5 s] q', 'W', 'unless'),
        ('H p', 'H', 'historically'),
    ],
)
def test_what_other_tools_write_is_corrected(text: str, mistake: str, meant: str) -> None:
    with pytest.raises(LanguageError, match=f"did you mean '{meant}' instead of ") as error:
        parse_formula(text)
    assert f"instead of '{mistake}'?" in str(error.value)


@pytest.mark.parametrize(
    ('text', 'advice'),
    [
        ('if a then b', "write 'p -> q' for 'if p then q'"),
        ('always (if a[u] > 5 then b)', "write 'p -> q' for 'if p then q'"),
        ('if (a > 5) then b', "write 'p -> q' for 'if p then q'"),
        ('if (a) then b', "write 'p -> q' for 'if p then q'"),
        ('When a: b', "write 'p -> q' for 'if p then q'"),
        ('a -> b else c', "write 'p -> q' for 'if p then q'"),
        ('implies (a > 5, b)', "did you mean '->' instead of 'implies'?"),
        ('a implies b', "did you mean '->' instead of 'implies'?"),
        ('G[0,5] a', "did you mean 'always' instead of 'G'?"),
        ('always "/a".v > .5', 'did you mean 0.5 instead of .5?'),
        ('always[0 s, .5 s] p', 'did you mean 0.5 instead of .5?'),
        ('x > 5. and y', 'did you mean 5.0 instead of 5.?'),
        ('x > +5', 'numbers have no sign +: write 5'),
        ('x > 1,5', 'did you mean 1.5 instead of 1,5?'),
        ('0 <= "/a".x[1] < 5', "join comparisons with 'and': '0 < x and x < 5'"),
        ('x in [0, 5]', "write an interval of values as '0 <= x and x <= 5'"),
        (
            'always within 5 s a',
            "write the time after the operator, as in 'eventually[0 s, 5 s] p'",
        ),
        ('X a', "there is no 'next': write 'eventually(0 s, 1 s] p'"),
        ('always p for 5 s', "did you mean 'always[0 s, 5 s] p' instead of 'for'?"),
        ('Mode = "on" => p', "did you mean '->' or '>=' instead of '=>'?"),
        ('x > 3 % && p', "did you mean 'and' instead of '&&'?"),
        ('p xor q', "did you mean 'not (p <-> q)' instead of 'xor'?"),
        ('avg(x[u] for u in U) > 1', "did you mean 'mean' instead of 'avg'?"),
        (
            'rate("/a", -2 s).hz > 1',
            'write tf("map", "base_link").yaw, action("/dock").name or rate("/scan", 2 s).hz',
        ),
        (
            'x < squareroot(2)',
            "'squareroot' is no function, and the arguments of a feature are names of objects",
        ),
        (
            'x < foo(y, 2)',
            "'foo' is no function, and the arguments of a feature are names of objects",
        ),
        ('|x| > 1', "write an absolute value as 'abs(x)'"),
        ('always p and |x - y| > 1', "write an absolute value as 'abs(x)'"),
        ('always p | q | r', "did you mean 'or' instead of '|'?"),
        ('P[] > 1', 'write an argument, an index or a time between the brackets'),
        ('"/odom".ranges[ ] > 1', 'write an argument, an index or a time between the brackets'),
        ('always[] p', 'write an argument, an index or a time between the brackets'),
        ('p and [] p', "did you mean 'always' instead of '[]'?"),
        ('x mod 2 = 0', "write a remainder as 'mod(x, 2)'"),
        ('always {a}', 'use round brackets'),
        ('flags % 2 = 1', "write a remainder as 'mod(x, 2)'"),
        ('[] a', "did you mean 'always' instead of '[]'?"),
        ('forall u in U: a[u]', "'U' is the operator 'until': rename the sort or feature"),
        ('always[0 sec, 5 s] a', 'the units of times are ns, us, ms, s, min, h'),
        ('always[0, 5 seconds) a', 'the units of times are ns, us, ms, s, min, h'),
        ('always "/a.x > 3', 'the closing quote is missing'),
        ('p and U[a] > 3', "'U' is the operator 'until': rename the sort or feature"),
    ],
)
def test_advice_on_what_other_languages_write(text: str, advice: str) -> None:
    with pytest.raises(LanguageError) as error:
        parse_formula(text)
    assert f': {advice} (unexpected ' in error.value.message.splitlines()[0]


@pytest.mark.parametrize(
    'text', ['x > 1.5.2', 'a and > 5', 'x > .', 'a b', 'then > 5 5', 'x > 1 -> -> y', 'min(3 4)']
)
def test_no_advice_where_none_is_known(text: str) -> None:
    with pytest.raises(LanguageError) as error:
        parse_formula(text)
    assert '(unexpected' not in error.value.message


def test_the_greatest_absolute_value_of_an_array() -> None:
    formula = parse_formula('max(abs("/arm".effort[1:])) < 40')
    assert str(formula) == 'max(max("/arm".effort[1:]), 0 - min("/arm".effort[1:])) < 40'
    assert parse_formula(str(formula)) == formula
    with pytest.raises(LanguageError, match="'min' takes a field of a stream, not 'abs"):
        parse_formula('min(abs("/arm".effort)) < 40')


@pytest.mark.parametrize(
    ('text', 'expected', 'reference'),
    [
        (
            'min("/scan".ranges[90:270]) < 0.5',
            'min("/scan".ranges[90:270]) < 0.5',
            FieldReference('/scan', 'min(ranges[90:270])'),
        ),
        (
            'any(scan.ranges<0.3)',
            'any(scan.ranges < 0.3)',
            FieldReference('scan', 'any(ranges < 0.3)'),
        ),
        (
            'count ( "/scan".ranges[:9] != -1 ) >= 2',
            'count("/scan".ranges[:9] != -1) >= 2',
            FieldReference('/scan', 'count(ranges[:9] != -1)'),
        ),
        (
            '"/joints".position[ name="elbow" ] < 1.5',
            '"/joints".position[name = "elbow"] < 1.5',
            FieldReference('/joints', 'position[name = "elbow"]'),
        ),
        (
            '"/plan".points[ info.next ].x < 1.5',
            '"/plan".points[info.next].x < 1.5',
            FieldReference('/plan', 'points[info.next].x'),
        ),
        (
            '11 < "/d".status[name = "a"].values[key = "100 %"].value',
            '11 < number("/d".status[name = "a"].values[key = "100 %"].value)',
            FieldReference('/d', 'number(status[name = "a"].values[key = "100 %"].value)'),
        ),
        (
            '"/d".status[name = "a"].message = "OK"',
            '"/d".status[name = "a"].message = "OK"',
            FieldReference('/d', 'status[name = "a"].message'),
        ),
    ],
)
def test_values_in_arrays(text: str, expected: str, reference: FieldReference) -> None:
    formula = parse_formula(text)
    assert str(formula) == expected
    assert reference in list(walk(formula))
    assert parse_formula(expected) == formula


@pytest.mark.skipif(find_spec('action_msgs') is None, reason='the types of ROS are not installed')
@pytest.mark.parametrize(
    ('text', 'canonical'),
    [
        ('"/a".status = NavSatStatus.STATUS_GBAS_FIX', '"/a".status = 2'),
        ('Status = action_msgs/msg/GoalStatus.STATUS_ABORTED', 'Status = 6'),
        ('any("/a".list.status = NavSatStatus.STATUS_GBAS_FIX)', 'any("/a".list.status = 2)'),
        ('let bad = NavSatStatus.STATUS_GBAS_FIX in Status >= bad', 'Status >= 2'),
        ('Dock.ON = goals.STATUS / Dock.status', 'Dock.ON = (goals.STATUS / Dock.status)'),
    ],
)
def test_constants_of_message_types(text: str, canonical: str) -> None:
    assert str(parse_formula(text)) == canonical
    with pytest.raises(LanguageError, match="have no constant 'STATUS_ABRTED'; did you mean"):
        parse_formula('x = GoalStatus.STATUS_ABRTED')
    # It is 4 for actionlib_msgs, which action_msgs calls SUCCEEDED.
    with pytest.raises(LanguageError, match='is no constant of action_msgs/msg/GoalStatus; write'):
        parse_formula('x != GoalStatus.ABORTED')
