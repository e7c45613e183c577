"""Each recipe tells its traces apart, needs fields that exist, and can be added to a robot.yaml."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import yaml

from dyknow_command import main
from dyknow_configuration import Recipe, read_recipes

RECIPES = read_recipes()

_SECOND_NS = 1_000_000_000


def over_traces(recipe: Recipe) -> dict[str, Any]:
    """A recipe as a robot.yaml whose features are the columns of a trace, instead of topics."""
    robot = yaml.safe_load(recipe.robot)
    features = {
        name: {key: value for key, value in feature.items() if key != 'from'}
        for name, feature in robot['features'].items()
    }
    others = {key: value for key, value in robot.items() if key != 'streams'}
    return {**others, 'features': features}


@pytest.fixture
def check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[[Recipe, str], tuple[int, dict[str, Any]]]:
    """Return the exit code of `dyknow check`, and what it says of a recipe over a trace."""

    def run(recipe: Recipe, trace: str) -> tuple[int, dict[str, Any]]:
        robot, path = tmp_path / 'robot.yaml', tmp_path / 'trace.csv'
        robot.write_text(yaml.safe_dump(over_traces(recipe)), encoding='utf-8')
        path.write_text(trace, encoding='utf-8')
        code = main(['check', str(path), '--config', str(robot), '--json'])
        (result,) = json.loads(capsys.readouterr().out)['formulas']
        return code, result

    return run


def start_of(trace: str) -> float:
    return min(float(line.split(',')[0]) for line in trace.splitlines()[1:])


@pytest.mark.parametrize('recipe', RECIPES.values(), ids=lambda each: each.name)
def test_a_recipe_tells_its_traces_apart(
    recipe: Recipe, check: Callable[[Recipe, str], tuple[int, dict[str, Any]]]
) -> None:
    code, result = check(recipe, recipe.satisfied)
    assert (code, result['passed']) == (0, True), result
    code, result = check(recipe, recipe.violated)
    assert (code, result['outcome']) == (1, 'false'), result
    (episode,) = result['episodes']
    decided = episode['decided_at_ns'] - episode['begin_ns']
    assert decided / _SECOND_NS + start_of(recipe.violated) == pytest.approx(
        recipe.violated_at / _SECOND_NS
    )
