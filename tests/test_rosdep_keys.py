"""`rosdep install`, as the README has it, knows all keys of package.xml on Ubuntu 24.04."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement

pytest.importorskip('rosdep2', reason='rosdep is not installed')

ROOT = Path(__file__).parent.parent
STORED = Path(__file__).parent / 'rosdep'
ROSDEP = 'import sys; from rosdep2.main import rosdep_main; sys.exit(rosdep_main())'
TOO_OLD = {'python3-rdflib'}
"""Keys of packages that Ubuntu 24.04 has in a version below the bounds of package.xml."""


def readme_command(first: str) -> list[str]:
    """The words of a command of the README that begins with a word."""
    text = (ROOT / 'README.md').read_text(encoding='utf-8').replace('\\\n', ' ')
    (line,) = re.findall(
        rf'^{first} .*--skip-keys.*$|^{first} install .*rdflib.*$', text, re.MULTILINE
    )
    return shlex.split(line)


@pytest.fixture(scope='module')
def environment(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """The environment of a rosdep that knows the stored keys alone."""
    folder = tmp_path_factory.mktemp('rosdep')
    (folder / 'sources').mkdir()
    source = f'yaml {(STORED / "keys.yaml").as_uri()}\n'
    (folder / 'sources' / '20-default.list').write_text(source)
    environment = {
        **os.environ,
        'ROSDEP_SOURCE_PATH': str(folder / 'sources'),
        'ROS_HOME': str(folder / 'home'),
        'ROSDISTRO_INDEX_URL': (STORED / 'index.yaml').as_uri(),
        'ROS_DISTRO': 'jazzy',
        'ROS_VERSION': '2',
        'ROS_PYTHON_VERSION': '3',
    }
    updated = rosdep(['update', '--rosdistro', 'jazzy'], environment)
    assert updated.returncode == 0, updated.stderr
    return environment


def rosdep(arguments: list[str], environment: dict[str, str]) -> Any:
    return subprocess.run(
        [sys.executable, '-c', ROSDEP, *arguments],
        env=environment,
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )


def test_the_command_of_the_readme_resolves_all_keys(environment: dict[str, str]) -> None:
    _, *arguments = readme_command('rosdep')
    # Folders that a build has made are not part of a fresh clone.
    packages = [str(path.parent) for path in sorted(ROOT.glob('dyknow_*/package.xml'))]
    place = arguments.index('--from-paths') + 1
    arguments[place : place + 1] = packages
    done = rosdep([*arguments, '--simulate', '--os=ubuntu:noble'], environment)
    assert done.returncode == 0, done.stderr


def test_an_unknown_key_is_told(environment: dict[str, str], tmp_path: Path) -> None:
    """Otherwise the test above would prove nothing."""
    (tmp_path / 'package.xml').write_text(
        '<package format="3"><name>any</name><version>1.0.0</version><description>any</description>'
        '<maintainer email="any@example.org">any</maintainer><license>any</license>'
        '<exec_depend>python3-pint</exec_depend></package>'
    )
    arguments = ['install', '--from-paths', str(tmp_path), '--simulate', '--os=ubuntu:noble']
    done = rosdep(arguments, environment)
    assert done.returncode == 1
    assert 'Cannot locate rosdep definition for [python3-pint]' in done.stderr


def skipped_keys() -> set[str]:
    words = readme_command('rosdep')
    return set(words[words.index('--skip-keys') + 1].split())


def test_skipped_keys_are_those_that_rosdep_cannot_serve() -> None:
    known = yaml.safe_load((STORED / 'keys.yaml').read_text(encoding='utf-8'))
    declared = {
        each.text: each.attrib
        for path in ROOT.glob('dyknow_*/package.xml')
        for each in ET.parse(path).getroot()  # noqa: S314 - our own file
        if each.tag.endswith('depend') and each.text and not each.text.startswith('dyknow_')
    }
    assert skipped_keys() == (declared.keys() - known.keys()) | TOO_OLD
    assert all(declared[key].get('version_gte') for key in TOO_OLD)


def test_pip_installs_what_is_skipped_within_its_bounds() -> None:
    _, _, *words = readme_command('pip')
    installed = {each.name: each.specifier for each in map(Requirement, words)}
    names = {key.removeprefix('python3-').removesuffix('-pip') for key in skipped_keys()}
    assert installed.keys() == names
    for path in ROOT.glob('dyknow_*/package.xml'):
        for each in ET.parse(path).getroot():  # noqa: S314 - our own file
            name = (each.text or '').removeprefix('python3-')
            if name in installed and (least := each.get('version_gte')):
                assert installed[name].contains(least)
                assert not installed[name].contains(each.get('version_lt', ''))
