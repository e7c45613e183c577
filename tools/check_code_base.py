"""Check the rules of the code base that ruff, mypy and import-linter do not know.

- A class name means one thing in all packages.
- Modules do not import each other in a circle.
- A package has at most the lines of its budget in pyproject.toml, a file at most MAX_LINES, a
  function at most MAX_FUNCTION_LINES.
- A file of tests has a name of its own: where ROS is installed, launch_testing imports it by this
  name.
- package.xml declares what the code of its package imports, and nothing else.
- All packages and the wheel have one version.
"""

from __future__ import annotations

import ast
import re
import sys
import tomllib
import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterable, Iterator
from graphlib import CycleError, TopologicalSorter
from itertools import chain
from pathlib import Path

import grimp

ROOT = Path(__file__).parent.parent
SPARE_LINES = 200
"""A budget that is larger by more is to be lowered."""
MAX_LINES = 600
MAX_FUNCTION_LINES = 40

COUNTED = {'.py', '.lark', '.js', '.css', '.html', '.msg', '.srv', '.action'}
"""The endings of files with code."""

ROSDEP_KEYS = {
    'backports': 'python3-backports.zstd-pip',
    'hypothesis': 'python3-hypothesis',
    'jsonschema': 'python3-jsonschema',
    'junitparser': 'python3-junitparser',
    'lark': 'python3-lark-parser',
    'lz4': 'python3-lz4',
    'numpy': 'python3-numpy',
    'owlready2': 'python3-owlready2-pip',
    'pint': 'python3-pint',
    'pytest': 'python3-pytest',
    'prometheus_client': 'python3-prometheus-client',
    'pyulog': 'python3-pyulog-pip',
    'rdflib': 'python3-rdflib',
    'rich': 'python3-rich',
    'rosbags': 'python3-rosbags-pip',
    'tornado': 'python3-tornado',
    'yaml': 'python3-yaml',
}
"""The rosdep keys of Python packages; a ROS package has its own name for a key."""

UNIMPORTED = {'python3-pytest-timeout', 'ros2launch'}
"""Dependencies that are used without an import."""

OPTIONAL = {
    'compression', 'dask', 'distributed', 'mypy', 'opentelemetry', 'ros2cli', 'scipy', 'sentil',
    'sros2', 'zenoh',
}  # fmt: skip
"""Imports that are skipped where the package is missing."""


def packages() -> list[str]:
    """Return the names of the Python packages of the workspace."""
    return sorted(path.parent.name for path in ROOT.glob('dyknow_*/setup.py'))


def modules(package: str) -> list[Path]:
    """Return the files of the modules of a package and of the Python packages beside it."""
    return sorted((ROOT / package).glob('dyknow_*/**/*.py'))


def parsed(path: Path) -> ast.Module:
    """Return the syntax tree of a file."""
    return ast.parse(path.read_text(encoding='utf-8'))


def repeated_class_names() -> Iterator[str]:
    """Report each class name that is defined more than once."""
    found = defaultdict(list)
    for path in chain.from_iterable(map(modules, packages())):
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.ClassDef):
                found[node.name].append(f'{path.relative_to(ROOT)}:{node.lineno}')
    for name, places in sorted(found.items()):
        if len(places) > 1:
            yield f'class {name} is defined {len(places)} times: {", ".join(places)}'


def import_cycles() -> Iterator[str]:
    """Report a circle of imports, if there is one."""
    graph = grimp.build_graph(*packages(), cache_dir=None)
    imports = {
        module: graph.find_modules_directly_imported_by(module)
        for module in graph.modules
        if (graph.find_children(module) == set())
    }
    try:
        TopologicalSorter(imports).prepare()
    except CycleError as error:
        yield f'these modules import each other: {" -> ".join(reversed(error.args[1]))}'


def budget_faults() -> Iterator[str]:
    """Report packages with more lines than their budget, and budgets that are to be lowered."""
    budgets = tomllib.loads((ROOT / 'pyproject.toml').read_text(encoding='utf-8'))['tool']['lines']
    found = {path.name: lines_of(path) for path in ROOT.glob('dyknow_*') if path.is_dir()}
    for package, lines in sorted(found.items()):
        budget = budgets.get(package, 0)
        if lines > budget:
            yield f'{package} has {lines} lines, more than the {budget} of its budget'
        elif lines < budget - SPARE_LINES:
            yield f'{package} has {lines} lines: lower its budget of {budget} in pyproject.toml'


def lines_of(package: Path) -> int:
    """Return the lines of a package in all languages, without its tests."""
    paths = (path for path in package.rglob('*') if path.suffix in COUNTED)
    product = (path for path in paths if 'test' not in path.relative_to(package).parts)
    return sum(len(path.read_text(encoding='utf-8').splitlines()) for path in product)


def long_code() -> Iterator[str]:
    """Report files and functions with too many lines."""
    for path in chain.from_iterable(map(modules, packages())):
        lines = len(path.read_text(encoding='utf-8').splitlines())
        if lines > MAX_LINES:
            yield f'{path.relative_to(ROOT)} has {lines} lines, more than {MAX_LINES}'
        for node in ast.walk(parsed(path)):
            if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
                lines = (node.end_lineno or node.lineno) - node.lineno + 1
                if lines > MAX_FUNCTION_LINES:
                    place = f'{path.relative_to(ROOT)}:{node.lineno}'
                    yield f'{place}: {node.name} has {lines} lines, more than {MAX_FUNCTION_LINES}'


def repeated_test_names() -> Iterator[str]:
    """Report each name that several files of tests have."""
    found = defaultdict(list)
    for folder in ('tests', *(f'{package}/test' for package in packages())):
        for path in sorted((ROOT / folder).rglob('test_*.py')):
            found[path.name].append(str(path.relative_to(ROOT)))
    for name, places in sorted(found.items()):
        if len(places) > 1:
            yield f'{len(places)} files of tests are called {name}: {", ".join(places)}'


def undeclared_dependencies() -> Iterator[str]:
    """Report differences between the imports of a package and its package.xml."""
    for package in packages():
        manifest = ET.parse(ROOT / package / 'package.xml').getroot()  # noqa: S314 - our own file
        run = {each.text for kind in ('depend', 'exec_depend') for each in manifest.iter(kind)}
        test = {each.text for each in manifest.iter('test_depend')}
        tests = list((ROOT / package / 'test').rglob('*.py'))
        product = [*modules(package), *(ROOT / package).glob('launch/*.py')]
        beside = {path.parent.name for path in ROOT.glob('dyknow_*/dyknow_*/__init__.py')}
        ours = {package, *(beside - {*packages()}), *OPTIONAL, *(path.stem for path in tests)}
        imports, names = used(product)
        imports_of_tests, names_of_tests = used(tests)
        lacking = imports - run - ours
        yield from (f'{package}/package.xml lacks <depend>{each}</depend>' for each in lacking)
        lacking = imports_of_tests - run - test - ours
        yield from (
            f'{package}/package.xml lacks <test_depend>{each}</test_depend>' for each in lacking
        )
        unused = (run - imports - names) | (test - imports_of_tests - names_of_tests)
        yield from (
            f'{package}/package.xml declares {each}, which nothing uses'
            for each in sorted(unused - UNIMPORTED)
        )


def used(paths: Iterable[Path]) -> tuple[set[str], set[str]]:
    """Return the rosdep keys of what some files import, and the packages that they name."""
    nodes = [node for path in paths for node in ast.walk(parsed(path))]
    return {*imported(nodes)}, {*named(nodes)}


def imported(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Yield the rosdep keys of the packages that some code imports."""
    for node in nodes:
        names: list[str] = []
        if isinstance(node, ast.Import):
            names = [each.name for each in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or '']
        for top in {name.split('.')[0] for name in names} - sys.stdlib_module_names:
            yield ROSDEP_KEYS.get(top, top)


def named(nodes: Iterable[ast.AST]) -> Iterator[str]:
    """Yield the packages that some code names: of executables, modules or types of messages."""
    for node in nodes:
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.value
            yield from re.findall(r'\b(\w+)/(?:msg|srv|action)/', node.value)
            yield from re.findall(r'^(dyknow_\w+)\.', node.value)


def different_versions() -> Iterator[str]:
    """Report the versions of the packages, if they have several."""
    found = defaultdict(list)
    for pattern, version in (
        ('dyknow_*/package.xml', r'<version>(.*)</version>'),
        ('dyknow_*/setup.py', r"version='(.*)'"),
    ):
        for path in sorted(ROOT.glob(pattern)):
            match = re.search(version, path.read_text(encoding='utf-8'))
            found[match[1] if match else 'no version'].append(str(path.relative_to(ROOT)))
    if len(found) > 1:
        places = '; '.join(f'{each}: {", ".join(paths)}' for each, paths in sorted(found.items()))
        yield f'the packages have {len(found)} versions, give them one: {places}'


def main() -> int:
    """Print what breaks a rule; return 1 if anything does."""
    faults = [
        *repeated_class_names(),
        *import_cycles(),
        *budget_faults(),
        *long_code(),
        *repeated_test_names(),
        *undeclared_dependencies(),
        *different_versions(),
    ]
    print('\n'.join(faults) or 'The code base keeps its rules.')
    return 1 if faults else 0


if __name__ == '__main__':
    sys.exit(main())
