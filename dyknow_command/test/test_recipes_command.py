"""The verb `recipes`: it lists, searches, shows and adds; its errors and its width."""

from __future__ import annotations

import json
from difflib import unified_diff
from pathlib import Path

import pytest
import yaml

import dyknow_command
from dyknow_configuration import read_recipes, read_robot

ROVER = Path(__file__).parent.parent.parent / 'examples' / 'rover' / 'robot.yaml'


@pytest.fixture(autouse=True)
def terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('COLUMNS', '80')


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    code = dyknow_command.main(['recipes', *map(str, arguments)])
    shown = capsys.readouterr()
    return code, shown.out, shown.err


def listed(text: str) -> list[str]:
    """The names of the recipes in a list."""
    return [line.split()[0] for line in text.splitlines()[1:] if not line.startswith(' ')]


def test_the_list_fits_a_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    code, shown, _ = run(capsys)
    assert code == 0
    assert listed(shown) == [*read_recipes()]
    assert max(map(len, shown.splitlines())) <= 80


@pytest.mark.parametrize(
    ('words', 'found'),
    [
        (['px4', 'COM_DISARM_LAND'], {'landing_disarms'}),
        (['GoalStatus'], {'goal_aborted'}),
        (['GoalStatusArray', 'px4'], set()),
        (['nav2_msgs/action/DockRobot'], {'docking_charges'}),
        (['singularity', 'servo'], {'singularity_halt'}),
    ],
)
def test_a_search(words: list[str], found: set[str], capsys: pytest.CaptureFixture[str]) -> None:
    code, shown, _ = run(capsys, *words)
    assert code == (0 if found else 2)
    assert {*listed(shown)} == found


@pytest.mark.parametrize(
    ('arguments', 'message'),
    [
        (['batery'], 'no recipe has batery; "dyknow recipes" lists all'),
        (['gripper', 'battery'], 'no recipe has gripper and battery; "dyknow recipes" lists all'),
        (['tilt', '--rename', 'a=b'], '--rename needs --add FILE'),
        (['--add', 'x.yaml'], '--add needs the name of a recipe; "dyknow recipes" lists all'),
        (['tlt', '--add', 'x.yaml'], "unknown recipe 'tlt'; did you mean 'tilt'?"),
        (
            ['tilt', '--add', 'x.yaml', '--rename', 'Robot'],
            "'' cannot be a name; use letters, digits and _",
        ),
        (['tilt', '--add', 'no/x.yaml'], 'cannot write no/x.yaml: No such file or directory'),
    ],
)
def test_errors(
    arguments: list[str],
    message: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert run(capsys, *arguments) == (2, '', f'dyknow: {message}\n')
    assert not [*tmp_path.iterdir()]


def test_a_recipe_is_shown_as_a_robot(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    for recipe in read_recipes().values():
        code, shown, _ = run(capsys, recipe.name)
        path.write_text(shown, encoding='utf-8')
        (formula,) = read_robot(path).formulas
        assert (code, formula.name) == (0, recipe.name)
        lines = shown.splitlines()
        assert lines[0] == f'# {recipe.name}, for {recipe.area} robots'
        assert [f'#   {each}' for each in recipe.violated.splitlines()] == lines[
            -len(recipe.violated.splitlines()) :
        ]
        # Links do not break, nor do names of topics and statuses, nor the headers of traces.
        assert not [
            each
            for each in lines
            if len(each) > 80 and not any(part in each for part in ('/', '"', 'time_s,'))
        ]


def test_recipes_as_json(capsys: pytest.CaptureFixture[str]) -> None:
    code, shown, _ = run(capsys, '--json')
    documents = [json.loads(line) for line in shown.splitlines()]
    assert (code, [each['name'] for each in documents]) == (0, [*read_recipes()])
    assert documents[0]['topics'] == {'/{r}/odom': 'nav_msgs/msg/Odometry'}
    assert documents[0]['violated_at_ns'] == 2_000_000_000
    assert yaml.safe_load(documents[0]['robot'])['formulas'][0]['name'] == 'speed_limit'


def test_a_recipe_is_added_to_the_rover(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    path, before = Path('robot.yaml'), ROVER.read_text(encoding='utf-8')
    path.write_text(before, encoding='utf-8')
    code, shown, error = run(capsys, 'speed_limit', '--add', path)
    assert (code, shown) == (2, '')
    assert "another feature 'Speed', a float of Rover in m/s" in error
    assert path.read_text(encoding='utf-8') == before
    code, shown, _ = run(capsys, 'speed_limit', '--add', path, '--rename', 'Robot=Rover')
    assert code == 0
    assert shown == (
        'robot.yaml: added constants top_speed; formulas speed_limit\n'
        'kept as in the file: objects Rover; features Speed\n'
        'change what differs on your robot:\n'
        '  top_speed: 1.2 m/s\n'
        'next: dyknow lint robot.yaml --live\n'
    )
    changes = unified_diff(before.splitlines(), path.read_text(encoding='utf-8').splitlines(), n=0)
    assert not [each for each in changes if each.startswith('-') and each != '--- \n']
    assert dyknow_command.main(['lint', str(path)]) == 0


def test_several_recipes_are_added_or_none(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    path = tmp_path / 'robot.yaml'
    code, shown, _ = run(capsys, 'tilt', 'separation', 'tilt', '--add', path)
    assert (code, shown, path.exists()) == (2, '', False)
    code, shown, _ = run(capsys, 'tilt', 'separation', '--add', path)
    assert code == 0
    assert 'kept as in the file: objects Robot\n' in shown
    assert '  /{r}/imu/data (sensor_msgs/msg/Imu)\n' in shown
    assert [each.name for each in read_robot(path).formulas] == ['separation', 'tilt']
    assert run(capsys, 'tilt', '--add', path)[0] == 2
