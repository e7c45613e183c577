"""The checks of the code base find what breaks a rule."""

from __future__ import annotations

import importlib.util
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parent.parent

MANIFEST = '<package><depend>numpy</depend><exec_depend>python3-rich</exec_depend></package>'


@pytest.fixture
def checks(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """The checks, applied to a small workspace of one package."""
    path = ROOT / 'tools' / 'check_code_base.py'
    spec = importlib.util.spec_from_file_location('check_code_base', path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    monkeypatch.setattr(module, 'ROOT', tmp_path)
    package = tmp_path / 'dyknow_example'
    (package / 'dyknow_example').mkdir(parents=True)
    (package / 'test').mkdir()
    (package / 'setup.py').touch()
    (package / 'package.xml').write_text(MANIFEST)
    return module


def write(checks: ModuleType, name: str, text: str) -> None:
    (checks.ROOT / 'dyknow_example' / 'dyknow_example' / name).write_text(text)


def test_a_class_name_in_two_modules(checks: ModuleType) -> None:
    write(checks, 'one.py', 'class State: pass\nclass Other: pass\n')
    assert not list(checks.repeated_class_names())
    write(checks, 'two.py', 'class State: pass\n')
    (fault,) = checks.repeated_class_names()
    assert fault.startswith('class State is defined 2 times: ')


def test_long_files_and_functions(checks: ModuleType) -> None:
    write(checks, 'one.py', 'def work():\n' + '    pass\n' * 39)
    assert not list(checks.long_code())
    write(checks, 'one.py', 'def work():\n' + '    pass\n' * 40 + '\n' * 560)
    assert [fault.partition(' has ')[2] for fault in checks.long_code()] == [
        '601 lines, more than 600',
        '41 lines, more than 40',
    ]


def test_budgets_of_lines(checks: ModuleType) -> None:
    def faults(budget: int) -> list[str]:
        text = f'[tool.lines]\ndyknow_example = {budget}\n'
        (checks.ROOT / 'pyproject.toml').write_text(text)
        return list(checks.budget_faults())

    write(checks, 'one.py', '\n' * 300)
    write(checks, 'page.js', '\n' * 50)
    (checks.ROOT / 'dyknow_example' / 'test' / 'test_one.py').write_text('\n' * 1000)
    assert not faults(350)
    assert faults(349) == ['dyknow_example has 350 lines, more than the 349 of its budget']
    assert not faults(550)
    assert faults(551) == [
        'dyknow_example has 350 lines: lower its budget of 551 in pyproject.toml'
    ]


def test_a_name_of_two_files_of_tests(checks: ModuleType) -> None:
    (checks.ROOT / 'dyknow_example' / 'test' / 'test_one.py').touch()
    assert not list(checks.repeated_test_names())
    (checks.ROOT / 'tests').mkdir()
    (checks.ROOT / 'tests' / 'test_one.py').touch()
    (fault,) = checks.repeated_test_names()
    assert fault.startswith('2 files of tests are called test_one.py: tests/test_one.py, ')


def test_dependencies_that_package_xml_and_imports_disagree_about(checks: ModuleType) -> None:
    write(checks, 'one.py', 'import re\nimport lark.lexer\nfrom rich import print\n')
    (checks.ROOT / 'dyknow_example' / 'test' / 'test_one.py').write_text('import hypothesis\n')
    assert sorted(checks.undeclared_dependencies()) == [
        'dyknow_example/package.xml declares numpy, which nothing uses',
        'dyknow_example/package.xml lacks <depend>python3-lark-parser</depend>',
        'dyknow_example/package.xml lacks <test_depend>python3-hypothesis</test_depend>',
    ]


def test_modules_that_import_each_other(
    checks: ModuleType, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(checks.ROOT / 'dyknow_example')
    write(checks, '__init__.py', '')
    write(checks, 'one.py', 'from dyknow_example import two\n')
    write(checks, 'two.py', '')
    assert not list(checks.import_cycles())
    write(checks, 'two.py', 'from dyknow_example import one\n')
    (fault,) = checks.import_cycles()
    assert 'dyknow_example.one' in fault
    assert 'dyknow_example.two' in fault


def test_packages_have_one_version(checks: ModuleType) -> None:
    package = checks.ROOT / 'dyknow_example'
    (package / 'setup.py').write_text("setup(\n    version='1.2.0',\n)\n")
    (package / 'package.xml').write_text('<package><version>1.2.0</version></package>')
    assert not list(checks.different_versions())
    (package / 'package.xml').write_text('<package><version>1.3.0</version></package>')
    (fault,) = checks.different_versions()
    assert '1.2.0: dyknow_example/setup.py; 1.3.0: dyknow_example/package.xml' in fault
