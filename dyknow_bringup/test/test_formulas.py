from math import inf
from pathlib import Path

import pytest

from dyknow_bringup import BringupError, DescribedFormula, load_formulas
from dyknow_reasoning import parse_formula
from dyknow_recordings.markers.fences import Fence, fences
from dyknow_recordings.markers.markers import DEFAULT_AXES

ONE = '{name: power, formula: always p, description: A sentence.}'


def test_the_formulas(formulas: dict[str, DescribedFormula]) -> None:
    assert list(formulas) == [
        'power', 'separation', 'ceiling', 'geofence', 'speed_limit', 'takeoff',
    ]  # fmt: skip
    assert formulas['power'].formula == (
        'forall u in UAV: always (Power[u] > 150 -> '
        'Power[u] < 200 until[0 s, 5 s] always[0 s, 3 s] Power[u] <= 150)'
    )
    assert formulas['ceiling'].description == 'Every vehicle stays below 30 m.'


def test_the_formulas_are_in_the_language(formulas: dict[str, DescribedFormula]) -> None:
    for formula in formulas.values():
        parsed = parse_formula(formula.formula)
        assert parse_formula(str(parsed)) == parsed


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('power: always p', "write a list instead of {'power': 'always p'}"),
        ('- {name: power, formula: always p}', "[0]: add the key 'description'"),
        (f'- {ONE}\n- {ONE}', "[1]: the name 'power' is taken; give this formula another one"),
        ('- {name: power, formula: 3, description: A.}', '[0].formula: write a text instead of 3'),
    ],
)
def test_bad_formulas_are_explained(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / 'bad.yaml'
    path.write_text(text, encoding='utf-8')
    with pytest.raises(BringupError) as error:
        load_formulas(path)
    assert str(error.value) == f'{path}: {message}'


def test_formulas_that_are_not_there(tmp_path: Path) -> None:
    with pytest.raises(BringupError) as error:
        load_formulas(tmp_path / 'none.yaml')
    assert str(error.value) == f'{tmp_path}/none.yaml: no such file'


def test_the_fences_of_the_demonstration(formulas: dict[str, DescribedFormula]) -> None:
    found = {name: fences(formula.formula, DEFAULT_AXES) for name, formula in formulas.items()}
    assert {name for name, some in found.items() if some} == {'ceiling', 'geofence'}
    assert found['geofence'] == (Fence((-30, -30, -inf), (60, inf, inf)),)
