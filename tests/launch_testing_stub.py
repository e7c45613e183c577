"""The part of launch_testing's pytest plugin that decides which tests are collected.

Where ROS 2 is installed, pytest loads launch_testing by itself. Its hook imports each test module
by its plain name, whatever the import mode is, to look for launch tests. If the import fails or is
skipped, pytest leaves out the whole folder; pytest 7 leaves out everything.
"""

from __future__ import annotations

import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest


class ImportedModule(pytest.Module):
    """A test module that is not imported again, under the name that the import mode gives it."""

    def _getobj(self) -> ModuleType:
        return sys.modules[self.path.stem]


def pytest_pycollect_makemodule(module_path: Path, parent: pytest.Collector) -> pytest.Module:
    """Import a test module as launch_testing does, and collect it."""
    if str(module_path.parent) not in sys.path:
        sys.path.insert(0, str(module_path.parent))
    module = import_module(module_path.stem)
    if module.__file__ != str(module_path):
        raise ImportError(f'{module_path} has the name of {module.__file__}; rename one')
    return ImportedModule.from_parent(parent, path=module_path)
