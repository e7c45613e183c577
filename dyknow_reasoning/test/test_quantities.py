"""Numbers with units and named constants."""

from __future__ import annotations

import pytest
from reasoning_reference import begun

from dyknow_common import LanguageError, TextPosition
from dyknow_reasoning import FormulaGroup, ReasoningError, parse_constants, parse_formula


@pytest.mark.parametrize(
    ('text', 'expected'),
    [
        ('let v: km/h in v[r] < 1 m/s', 'v[r] < 3.6'),
        ('let v: m/s in v[r] < 1 "m / s"', 'v[r] < 1'),
        ('let v: m/s in v[r]<1m/s and p', '(v[r] < 1) and p'),
        ('let v: m/s in -5 m/s <= v[r]', '-5 <= v[r]'),
        ('let x: cm in x <= 0.29 m', 'x <= 29.0'),
        ('let x: m in x = 9007199254740993 km', 'x = 9007199254740993000'),
        ('let T: K in T < 20 degC', 'T < 293.15'),
        ('let T: K in max(T, 0 degC) > 1 K', 'max(T, 273.15) > 1'),
        ('let T: degC in T - 5 degC < 90 degC', '(T - 5) < 90'),
        ('let D: m, t: s in D - 1 km < t * 10 m/s', '(D - 1000.0) < (t * 10)'),
        ('let D: m, t: s in D / t > 5 m/s', '(D / t) > 5'),
        ('let D: m, t: s in 1 / t < 2 Hz', '(1 / t) < 2'),
        ('let D: m in -D < 2 * 1 km', '(0 - D) < 2000.0'),
        ('let a: rad in angle_difference(a, 180 deg) < 1 deg', None),
        ('let D: m in D^2 < 4 km^2', 'pow(D, 2) < 4000000.0'),
        ('let D: m, E: m in sqrt(D^2 + E^2) < 4 km', 'sqrt(pow(D, 2) + pow(E, 2)) < 4000.0'),
        ('let D: m in (1 cm + D)^0.5 < 2 "m^0.5"', 'pow(0.01 + D, 0.5) < 2'),
        ('let t: s in t^-1 < 2 Hz', 'pow(t, -1) < 2'),
        ('let x: rad in sin(x - 1 "rad")^2 < 0.5', 'pow(sin(x - 1), 2) < 0.5'),
        ('let x: m in 2^count(x > 1 km, 5 s) < 8', 'pow(2, count(x > 1000.0, 5 s)) < 8'),
        ('let x: m in bit(count(x > 1 km, 5 s), 1) = 0', 'bit(count(x > 1000.0, 5 s), 1) = 0'),
        ('let x: m in 0.0 - x < 1 km', '(0.0 - x) < 1000.0'),
        ('let v: m/s in hypot(v, 36 km/h) > 2 m/s', None),
        ('let c: "%" in c > 20 %', 'c > 20'),
        ('let "/t".a[0].v: ft in "/t".a[0].v < 1 m', '"/t".a[0].v < 3.2808398950131235'),
        ('1 km > 2 m', '1 > 0.002'),
        ('v[r] < 1 m/s', 'v[r] < 1 "m/s"'),
        ('always[0, 5 s] t[r] < 5 s', 'always[0 s, 5 s] (t[r] < 5 "s")'),
        ('let a = 2, b = "on" in let c = true in x < a and m = b and (c = n)', None),
        (
            'over (L[a, b] by 5 km for a, b in S) from c to s: somewhere[0, 9 m] p[s]',
            'over (L[a, b] by 5 for a, b in S) from c to s: (somewhere[0, 0.009] (p[s]))',
        ),
        ('forall u in S: let most = 2 in P[u] < most', 'forall u in S: (P[u] < 2)'),
        ('let most = 2 in p until q or x < most', '(p until q) or (x < 2)'),
    ],
)
def test_canonical_texts(text: str, expected: str | None) -> None:
    found = str(parse_formula(text))
    assert str(parse_formula(found)) == found
    if expected is not None:
        assert found == expected


def test_a_constant_is_the_same_as_its_value() -> None:
    constants = parse_constants({'most': '-150 W', 'name': '"LAND"', 'on': 'true', 'no': '1e-3'})
    text = 'let P: kW in P < most or m = name or on = q or on or x < no'
    assert parse_formula(text, constants) == parse_formula(
        'let P: kW in P < -150 W or m = "LAND" or true = q or true or x < 0.001'
    )


def test_the_position_of_a_constant_is_that_of_its_use() -> None:
    with pytest.raises(LanguageError) as error:
        parse_formula('let most = 3 kg, v: m/s in\n always v < most')
    assert error.value.position == TextPosition(2, 13)
    assert '\'3 "kg"\' is in kg, which does not convert to m/s' in error.value.message


def test_constants_of_a_configuration_hide_nothing() -> None:
    constants = parse_constants({'most': '3'})
    for text in ('let most = 2 in x < most', 'always most[u] < 2', 'forall most in S: P[most]'):
        with pytest.raises(LanguageError, match=r"'most' is .*in the configuration; "):
            parse_formula(text, constants)


@pytest.mark.parametrize(
    ('name', 'value', 'message'),
    [
        ('most', '3 kgg', "formula:1:14: did you mean 'kg' instead of 'kgg'?"),
        ('most', 'x', "formula:1:5: the constant 'most' must be a number, a quoted text"),
        ('most', '1 + 2', "formula:1:5: the constant 'most' must be a number"),
        ('most', '1, b = 2', "formula: the constant 'most' must be one number"),
        ('a = 1, most', '1', "formula: the constant 'a = 1, most' must be one number"),
        ('in', '1', "formula:1:5: unexpected 'in'"),
    ],
)
def test_bad_constants(name: str, value: str, message: str) -> None:
    with pytest.raises(LanguageError) as error:
        parse_constants({name: value})
    assert error.value.message.startswith(message)


def test_a_temperature_has_no_multiples() -> None:
    with pytest.raises(LanguageError) as error:
        parse_formula('let T: K in T < 2 * 5 degC')
    assert 'a number in degC has no multiples; write the product, \'10 "degC"\'' in str(error.value)


def test_a_group_needs_to_know_the_units() -> None:
    group = FormulaGroup()
    group.add_formula('it', 'always Speed[u1] < 1 m/s')
    with pytest.raises(ReasoningError) as error:
        group.begin({})
    assert error.value.message == (
        "'1 \"m/s\"' has a unit, and the unit of 'Speed' is not known; state the unit, "
        'let Speed: UNIT in ..., or write a plain number'
    )
    known, _ = begun('let Speed: km/h in always Speed[u1] < 1 m/s')
    assert known.progress(0, {'Speed[u1]': 3.5}) == []
    (result,) = known.progress(1, {'Speed[u1]': 3.6})
    assert result.explanation.startswith('Speed[u1] = 3.6 at 0.000000001 s is not < 3.6')


@pytest.mark.parametrize(
    ('formula', 'speed', 'explanation'),
    [
        ('always v < 4 km/h', 1.2, 'v = 1.2 at 1.000 s is not < 1.111 m/s (4 km/h)'),
        ('always 4 km/h > v', 1.2, 'v = 1.2 at 1.000 s is not < 1.111 m/s (4 km/h)'),
        ('always v < 4 km/h', 1.1112, 'v = 1.1112 at 1.000 s is not < 1.111 m/s (4 km/h)'),
        ('eventually v > 4 km/h', 1.11115, 'v = 1.11115 at 1.000 s is > 1.111 m/s (4 km/h)'),
        ('always v > 4 km/h', 1.11105, 'v = 1.11105 at 1.000 s is not > 1.11111111 m/s (4 km/h)'),
        (
            'always v > 4 km/h',
            4 / 3.6,
            'v = 1.11111111 at 1.000 s is not > 1.11111111 m/s (4 km/h)',
        ),
        (
            'eventually v < 4 km/h',
            1.11111111111,
            'v = 1.11111111111 at 1.000 s is < 1.1111111111111112 m/s (4 km/h)',
        ),
        ('always v < 1 m/s', 1.2, 'v = 1.2 at 1.000 s is not < 1 m/s'),
        ('always v < 1', 1.2, 'v = 1.2 at 1.000 s is not < 1'),
        (
            'always v - 1 km/h < 0 km/h',
            1.2,
            'v - 1 km/h = 0.922222222 at 1.000 s is not < 0 m/s (0 km/h)',
        ),
        ('eventually[0 s, 1 s] v > 8 km/h', 1.2, "'v > 8 km/h' held at no state in [1.000 s, 2.0"),
        ('always once[0 s, 1 s] v > 8 km/h', 1.2, "'v > 8 km/h' held at no state from 1.000 s"),
        ('always v < 10 "in/s"', 1.2, 'v = 1.2 at 1.000 s is not < 0.254 m/s (10 "in/s")'),
        ('always v < 1 "m / s"', 1.2, 'v = 1.2 at 1.000 s is not < 1 m/s (1 "m / s")'),
    ],
)
def test_converted_numbers_are_shown_as_they_were_written(
    formula: str, speed: float, explanation: str
) -> None:
    group, _ = begun(f'let v: m/s in {formula}')
    results = [each for time in (1, 2) for each in group.progress(time * 10**9, {'v': speed})]
    assert results[0].explanation.startswith(explanation)
    assert results[0].explanation.endswith(explanation) or 'held' in explanation


def test_many_lets_take_linear_time() -> None:
    bindings = ', '.join(f'c{index} = {index}' for index in range(20_000))
    uses = ' and '.join(f'x < c{index}' for index in range(50))
    assert str(parse_formula(f'let {bindings} in {uses}')).count('x <') == 50
