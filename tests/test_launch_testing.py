"""Tests are collected in full where the pytest plugin of launch_testing is installed."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

FOLDER = Path(__file__).parent
ROOT = FOLDER.parent


def collected(root: Path, *folders: str) -> subprocess.CompletedProcess[str]:
    paths = os.pathsep.join([str(FOLDER), os.environ.get('PYTHONPATH', '')])
    options = ('-p', 'launch_testing_stub', '-p', 'no:cacheprovider', '--collect-only', '-q')
    return subprocess.run(
        [sys.executable, '-m', 'pytest', *options, *folders],
        cwd=root,
        env={**os.environ, 'PYTHONPATH': paths},
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )


def test_the_tests_of_the_packages_are_collected() -> None:
    modules = [path.relative_to(ROOT) for path in ROOT.glob('dyknow_*/test/**/test_*.py')]
    found = collected(ROOT, *sorted({f'{path.parts[0]}/test' for path in modules}))
    assert found.returncode == 0, found.stdout
    assert 'SKIPPED' not in found.stdout
    assert {line.partition('::')[0] for line in found.stdout.splitlines() if '::' in line} == {
        str(path) for path in modules
    }


@pytest.mark.parametrize(
    ('other', 'text'),
    [
        ('one/test_skipped.py', 'import pytest\npytest.importorskip("nothing_of_this_name")\n'),
        ('two/test_first.py', 'def test_other() -> None: pass\n'),
    ],
)
def test_a_module_that_leaves_out_others_is_noticed(other: str, text: str, tmp_path: Path) -> None:
    (tmp_path / 'pytest.ini').write_text('[pytest]\naddopts = --import-mode=importlib\n')
    for name, content in {
        'one/test_first.py': 'def test_it() -> None: pass\n',
        other: text,
    }.items():
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(content)
    found = collected(tmp_path, 'one', 'two') if other.startswith('two') else collected(tmp_path)
    assert found.returncode != 0
