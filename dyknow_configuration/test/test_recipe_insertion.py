"""A recipe is added to a robot.yaml of any layout: what was there stays as it was."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from dyknow_common import ExitCode
from dyknow_configuration import ConfigurationError, Recipe, RobotPart, add_recipe, read_recipes

PATH = Path('robot.yaml')
RECIPES = read_recipes()

# Each section in several layouts; an empty text leaves it out.
OBJECTS = (
    '',
    'objects:\n',
    'objects: ~  # none yet\n',
    'objects: {}\n',
    'objects: {Rover: [r1, r2]}\n',
    'objects: {Rover: [r1, r2], }  # two\n',
    'objects:\n  Rover: [r1, r2]\n',
    'objects:\n    Rover:\n    - r1\n    - r2  # the second one\n\n',
    'objects:\n  Rover: [r1, r2]\n  Robot: [mine, yours]  # the same sort\n',
    'objects: {\n  Rover: [r1, r2]  # two\n}\n',
)
CONSTANTS = (
    '',
    'constants: {limit: 2 m/s}\n',
    'constants:\n  limit: 2 m/s  # fast\n  # a comment at the end\n',
    "constants:\n  'limit': '2 m/s'\n  still: 0.1 m/s\n",
)
FEATURES = (
    '',
    'features: {}\n',
    "features: {Wind: {unit: m/s, from: {topic: /wind, field: 'data'}}}\n",
    'features:\n  Wind:\n    unit: m/s\n    description: >-\n      How\n      strong.\n\n',
    'features:\n  # The wind.\n  Wind: {unit: m/s}\n',
)
STREAMS = (
    '',
    'streams: []\n',
    'streams: \'stream a = select x from "/a"; sink a\'\n',
    'streams: |\n  stream a = select x from "/a";\n  # the end\n  sink a;\n',
    'streams: |+\n  stream a = select x from "/a";\n  sink a\n\n\n',
    'streams:\n- stream a = select x from "/a"; sink a\n',
    'streams:\n  - |\n    stream a = select x from "/a";\n    sink a;\n\n',
    'streams:\n  for: {r: Rover}\n  text: |\n    stream {r} = select x from "/a"; sink {r}\n',
    'streams: [\'stream a = select x from "/a"; sink a\']\n',
)
FORMULAS = (
    '',
    'formulas:\n',
    'formulas: [{name: a, formula: always "/a".x < 1}]\n',
    'formulas:\n- name: a\n  formula: always "/a".x < 1\n',
    'formulas:\n    - {name: a, formula: always "/a".x < 1}  # the only one\n',
    'formulas:\n  - name: a\n    formula: >-\n      always "/a".x\n      < 1\n# the end\n',
)


@st.composite
def robots(draw: st.DrawFn) -> str:
    """A robot.yaml whose sections are in any order and layout."""
    streams = draw(st.sampled_from(STREAMS))
    objects = [each for each in OBJECTS if 'Rover' in each or 'Rover' not in streams]
    layouts = (objects, CONSTANTS, FEATURES, FORMULAS)
    sections = [draw(st.sampled_from(each)) for each in layouts]
    head = draw(st.sampled_from(('', '# A rover.\n', '---\n')))
    between = draw(st.sampled_from(('', '\n', '# ---\n')))
    text = head + between.join(draw(st.permutations([*sections, streams])))
    # A last line may have no end, but that is a part of some texts.
    return text if '|' in text or draw(st.booleans()) else text.rstrip('\n')


def merged(text: str, recipe: Recipe, kept: tuple[RobotPart, ...]) -> Any:
    """The content that is expected, by a plain merge."""
    content = yaml.safe_load(text) or {}
    for section, part in yaml.safe_load(recipe.robot).items():
        given_ = content.get(section)
        if isinstance(part, list):
            known = [each.plain for each in kept if each.section == section]
            before = given_ if isinstance(given_, list) else [given_] if given_ else []
            content[section] = before + [each for each in part if each not in known]
        else:
            content[section] = {**part, **(given_ or {})}
    return content


def is_kept(before: str, after: str) -> bool:
    """True if all characters of a text are in another one, in their order, but for a null."""
    characters = iter(''.join(after.split()))
    return all(each in characters for each in ''.join(before.replace(': ~', ':').split()))


@given(robots(), st.sampled_from([*RECIPES]))
def test_the_file_is_what_it_was_with_the_recipe(text: str, name: str) -> None:
    recipe = RECIPES[name]
    added = add_recipe(PATH, text, recipe)
    content = yaml.safe_load(added.text)
    assert content == merged(text, recipe, added.kept)
    assert {*added.added, *added.kept} == {*recipe.parts}
    assert is_kept(text, added.text)


@given(robots(), st.lists(st.sampled_from([*RECIPES]), max_size=4))
def test_recipes_share_what_they_have_in_common(text: str, names: list[str]) -> None:
    # The first one lists as many objects as any of them needs.
    names = [*dict.fromkeys(['hand_over', *names])]
    for each in names:
        text = add_recipe(PATH, text, RECIPES[each]).text
    found = [each['name'] for each in yaml.safe_load(text)['formulas']]
    assert [each for each in found if each != 'a'] == names


def refused(text: str, recipe: Recipe) -> ConfigurationError:
    with pytest.raises(ConfigurationError) as error:
        add_recipe(PATH, text, recipe)
    return error.value


def test_a_formula_is_added_once() -> None:
    recipe = RECIPES['speed_limit']
    error = refused(add_recipe(PATH, '', recipe).text, recipe)
    assert error.code == ExitCode.ALREADY_EXISTS
    assert '--rename speed_limit=OTHER_NAME' in error.message
    again = recipe.renamed({'speed_limit': 'slower', 'top_speed': 'low_speed'})
    text = add_recipe(PATH, add_recipe(PATH, '', recipe).text, again).text
    assert [each['name'] for each in yaml.safe_load(text)['formulas']] == ['speed_limit', 'slower']
    assert yaml.safe_load(text)['constants'] == {'top_speed': '1.2 m/s', 'low_speed': '1.2 m/s'}


@pytest.mark.parametrize(
    ('feature', 'message'),
    [
        ('of: {r: Rover}, unit: m/s', 'a float of Rover in m/s; that of the recipe is a float of'),
        ('of: {r: Robot}, unit: m', 'a float of Robot in m; that of the recipe'),
        ('of: {r: Robot}', 'a float of Robot; that of the recipe'),
        ('of: {r: Robot}, type: string', 'a string of Robot; that of the recipe'),
    ],
)
def test_a_feature_of_the_same_name_is_another_one(feature: str, message: str) -> None:
    text = f'objects: {{Rover: [a], Robot: [b]}}\nfeatures: {{Speed: {{{feature}}}}}\n'
    error = refused(text, RECIPES['speed_limit'])
    assert error.code == ExitCode.ALREADY_EXISTS
    assert f"another feature 'Speed', {message}" in error.message
    assert '--rename OLD=NEW' in error.message
    names = {'Robot': 'Rover'} if 'Rover' in feature else {'Speed': 'OtherSpeed'}
    add_recipe(PATH, text, RECIPES['speed_limit'].renamed(names))


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('features: {Speed: {unit: Q}}\n', "robot.yaml:1:26: unknown unit 'Q'"),
        ('objects: [a]\n', 'write'),
        ('{objects: {Robot: [a]}}\n', 'with the recipe, the file would be at fault'),
        ('x: &a {top: 1 m/s}\nconstants: *a\n', "unknown key 'x'"),
        ('constants: &a {top: 1 m/s}\nnodes: {stream_manager: *a}\n', ''),
        ('objects: {speed_limit: [a]}\nfeatures: {Robot: {}}\n', "'Robot' is the name of a"),
        ('sorts: {Rover: {}}\n', 'with the recipe, the file would be at fault'),
    ],
)
def test_a_file_that_cannot_be_changed_is_refused(text: str, message: str) -> None:
    assert message in refused(text, RECIPES['speed_limit']).message


def test_too_few_objects() -> None:
    error = refused('objects: {Robot: [mine]}\n', RECIPES['separation'])
    assert error.message == (
        "'separation' is about 2 objects of 'Robot' at least; robot.yaml has mine: add some first"
    )
    assert 'has none' in refused('objects: {Robot: []}\n', RECIPES['tilt']).message


def test_names_that_a_recipe_does_not_have() -> None:
    with pytest.raises(ConfigurationError, match="unknown name 'Robt'; did you mean 'Robot'"):
        RECIPES['speed_limit'].renamed({'Robt': 'Rover'})
    with pytest.raises(ConfigurationError, match="'always' cannot be a name"):
        RECIPES['speed_limit'].renamed({'Robot': 'always'})
