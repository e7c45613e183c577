"""The examples of the folder `examples`: their fake robots, recordings and expected outcomes."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

FOLDER = Path(__file__).parent.parent / 'examples'
SIMULATE = FOLDER / 'simulate.py'

# The examples are scripts of this folder, not a package.
sys.path.insert(0, str(FOLDER))
import simulate  # noqa: E402


@dataclass(frozen=True)
class Example:
    """A folder of the examples."""

    name: str

    @property
    def folder(self) -> Path:
        return FOLDER / self.name

    @property
    def configuration(self) -> Path:
        return self.folder / 'robot.yaml'

    @property
    def faults(self) -> list[str]:
        return list(simulate.fake_robot(self.name).FAULTS)

    @property
    def expected(self) -> Any:
        """The content of expected.yaml, with texts for `true` and `false`."""
        text = (self.folder / 'expected.yaml').read_text(encoding='utf-8')
        return yaml.load(text, yaml.BaseLoader)  # noqa: S506 - it makes texts only

    def outcomes(self, faults: list[str]) -> dict[str, str]:
        """Return the outcomes of the formulas that are not undecided."""
        expected = self.expected
        found = dict(expected['always'])
        for fault in faults:
            found.update(expected['faults'][fault])
        return found

    def record(self, faults: list[str], path: Path) -> None:
        simulate.record(simulate.fake_robot(self.name)(faults), path, 20.0)


EXAMPLES = tuple(Example(name) for name in simulate.EXAMPLES)
