"""Missions read from files."""

from pathlib import Path

import pytest

from dyknow_bringup.errors import BringupError
from dyknow_bringup.resources import plan_path
from dyknow_bringup.simulation.missions import Task, load_mission
from dyknow_configuration import ConfigurationError
from dyknow_coordinator import FormulaPosition, Holds, PlanExecution
from dyknow_reasoning import check_types, parse_formula


def test_the_shipped_mission_is_valid() -> None:
    mission = load_mission(plan_path('delivery'))
    assert [task.action for task in mission.tasks] == ['take_off', 'fly_to', 'land']
    assert mission.tasks[0] == Task('take_off', 'eventually Altitude[uav1] > 5.5', 12_000_000_000)
    formulas = mission.plan.formulas_by_position
    assert formulas[FormulaPosition('fly_to', 'not_before')].holds is Holds.BEFORE
    for text in (*(f.formula for f in formulas.values()), *(t.goal for t in mission.tasks)):
        check_types(parse_formula(text), text)
    PlanExecution(mission.plan)


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('name: p', "mission.yaml:1:1: add the key 'actions'"),
        (
            '{name: p, actions: [{name: a, goal: g}]}',
            "mission.yaml:1:21: add the key 'within'",
        ),
        (
            '{name: p, actions: [{name: a, goal: g, within: -5 s}]}',
            "mission.yaml:1:48: '-5 s' is negative",
        ),
        (
            '{name: p, actions: [], formulas: [{name: f, formula: g, holds: now}]}',
            "mission.yaml:1:64: unknown time of a formula 'now'; use while_executing",
        ),
    ],
)
def test_an_invalid_mission(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / 'mission.yaml'
    path.write_text(text)
    with pytest.raises(ConfigurationError) as caught:
        load_mission(path)
    assert words in str(caught.value)


def test_a_plan_that_is_not_there() -> None:
    with pytest.raises(BringupError, match="no plan 'picnic'; use delivery or"):
        plan_path('picnic')
