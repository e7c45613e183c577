"""Every fault in a robot.yaml is shown at its place, with the correction."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_configuration import ConfigurationError, read_robot

BAD = sorted((Path(__file__).parent / 'bad_robots').glob('*.yaml'))


@pytest.mark.parametrize('path', BAD, ids=[path.stem for path in BAD])
def test_a_bad_robot_is_explained(path: Path) -> None:
    with pytest.raises(ConfigurationError) as error:
        read_robot(path)
    message = str(error.value).replace(f'{path.parent}/', '')
    assert message == path.with_suffix('.expected').read_text(encoding='utf-8').rstrip('\n')


def test_there_are_bad_robots() -> None:
    assert len(BAD) > 50


def test_a_missing_file() -> None:
    with pytest.raises(ConfigurationError, match=r'cannot read the configuration in missing\.yaml'):
        read_robot(Path('missing.yaml'))


MANY = f'objects: {{R: [{", ".join(f"r{number}" for number in range(5_100))}]}}\n'


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        (
            MANY + 'features:\n  F: &f {of: {r: R}, from: {topic: "/{r}", field: x}}\n  G: *f\n',
            r'4:3: the file makes more than 10000 annotations; split it',
        ),
        (
            MANY + 'streams:\n  for: {a: R, b: R}\n  text: sink {a}_{b}\n',
            r'3:3: this makes more than 10000 copies; split it',
        ),
        (
            MANY + 'streams:\n  for: {r: R}\n  text: "stream {r} = {r} # ' + 'long' * 60 + '"\n',
            r'3:3: the streams have more than 1000000 characters; split them',
        ),
        ('[' * 100_000, 'not YAML: it nests too deep'),
        ('# \n' * 400_000, 'more than 1000000 characters; split it'),
        (f'formulas: {"long" * 99}\n', '1:11: there is no file .*longlong: File name too long'),
    ],
    ids=[
        'annotations',
        'copies',
        'characters of streams',
        'depth',
        'characters',
        'a text as a name',
    ],
)
def test_an_unusable_file(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(text)
    with pytest.raises(ConfigurationError, match=message):
        read_robot(path)


def test_too_many_objects(tmp_path: Path) -> None:
    path = tmp_path / 'robot.yaml'
    path.write_text(f'{MANY}  S: [{", ".join(f"s{number}" for number in range(5_000))}]\n')
    path.write_text(path.read_text().replace(MANY, MANY.replace('{R', '\n  R').replace(']}', ']')))
    with pytest.raises(ConfigurationError, match=r'3:6: the file lists more than 10000 objects'):
        read_robot(path)


def test_a_bad_file_of_formulas_is_named(tmp_path: Path) -> None:
    (tmp_path / 'more.yaml').write_text("- {name: a, formula: 'always alway p q'}\n")
    (tmp_path / 'robot.yaml').write_text('formulas: more.yaml\n')
    with pytest.raises(ConfigurationError, match=r'more\.yaml:1:36: did you mean'):
        read_robot(tmp_path / 'robot.yaml')
