from math import inf

from dyknow_configuration import RequestedFormula
from dyknow_reasoning import parse_formula
from dyknow_recordings.markers import DEFAULT_AXES, Fence, fences


def test_the_formulas(formulas: dict[str, RequestedFormula]) -> None:
    assert list(formulas) == [
        'power', 'separation', 'ceiling', 'geofence', 'speed_limit', 'takeoff',
    ]  # fmt: skip
    assert formulas['power'].text == (
        'forall u in UAV: always (Power[u] > 150 -> '
        'Power[u] < 200 until[0 s, 5 s] always[0 s, 3 s] Power[u] <= 150)'
    )
    assert formulas['ceiling'].description == 'Every vehicle stays below 30 m.'


def test_the_formulas_are_in_the_language(formulas: dict[str, RequestedFormula]) -> None:
    for formula in formulas.values():
        parsed = parse_formula(formula.text)
        assert parse_formula(str(parsed)) == parsed


def test_the_fences_of_the_demonstration(formulas: dict[str, RequestedFormula]) -> None:
    found = {name: fences(formula.text, DEFAULT_AXES) for name, formula in formulas.items()}
    assert {name for name, some in found.items() if some} == {'ceiling', 'geofence'}
    assert found['geofence'] == (Fence((-30, -30, -inf), (60, inf, inf)),)
