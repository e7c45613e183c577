"""Tests are collected in full where the pytest plugin of launch_testing is installed.

It imports each test module by its plain name. Where that is skipped, pytest leaves out the folder.
That no two modules have one name is checked by tools/check_code_base.py.
"""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parent.parent
SKIPPING = {'importorskip', 'skip', 'exit'}
"""Functions of pytest that end the import of a module."""


def obstacles(root: Path) -> list[str]:
    """Name what would leave out tests of the packages in a folder."""
    modules = sorted(root.glob('dyknow_*/test/**/test_*.py'))
    assert modules
    found: list[str] = []
    for path in modules:
        body = ast.parse(path.read_text(encoding='utf-8')).body
        defined = (ast.FunctionDef, ast.ClassDef, ast.AsyncFunctionDef)
        found += [
            f'{path}:{node.lineno}: skips the module'
            for statement in body
            if not isinstance(statement, defined)
            for node in ast.walk(statement)
            if isinstance(node, ast.Attribute) and node.attr in SKIPPING
        ]
    return found


def test_nothing_leaves_out_tests_of_the_packages() -> None:
    assert obstacles(ROOT) == []


def test_obstacles_are_noticed(tmp_path: Path) -> None:
    for name, text in {
        'dyknow_a/test/test_first.py': 'import pytest\nx = pytest.importorskip("nothing")\n',
        'dyknow_b/test/ros/test_first.py': 'def test_it() -> None: pytest.skip("here it may")\n',
    }.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True)
        path.write_text(text)
    assert [each.partition(': ')[2] for each in obstacles(tmp_path)] == ['skips the module']
