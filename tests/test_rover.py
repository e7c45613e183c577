"""The rover of the README and the manual, with the dyknow command."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import rover_telemetry
from commands import command, dyknow_up, output_beside, started
from system import Client, private_environment

EXAMPLES = Path(__file__).parent.parent / 'docs' / 'examples'


@pytest.fixture(scope='module')
def rover() -> Iterator[dict[str, str]]:
    """Run DyKnow for the rover of the README, as the README describes."""
    environment = private_environment()
    files = {name: str(EXAMPLES / f'rover.{name}') for name in ('owl', 'ssl', 'streams')}
    options = (
        '--ontology', files['owl'], '--annotations', files['ssl'], '--streams', files['streams'],
    )  # fmt: skip
    # The engine has warned that nobody publishes the topics of the rover.
    with dyknow_up(environment, *options, says='1 ontology (3 concepts, '):
        yield environment


class Rover:
    """Publishes the topics of the rover from a process of its own."""

    def __init__(self, environment: dict[str, str]) -> None:
        self.client = Client(environment)
        self._told: dict[str, Any] = {}
        line = [sys.executable, rover_telemetry.__file__]
        self._process = started(line, environment, stdin=subprocess.PIPE, stderr=None)
        assert self._process.stdout.readline() == 'ready\n'

    def close(self) -> None:
        """End the process."""
        self.client.close()
        self._process.communicate()
        assert self._process.returncode == 0

    def tell(self, **values: Any) -> None:
        """Change `charge`, `speed` or `publishes_battery`."""
        if self._told | values != self._told:
            self._told |= values
            print(json.dumps(values), file=self._process.stdin, flush=True)

    def run(self, line: list[str], environment: dict[str, str]) -> tuple[int, str]:
        """Publish while a process runs; return its exit code and its output."""
        done = output_beside(self.client, line, environment)
        return done.returncode, done.stdout


@pytest.fixture(scope='module')
def vehicle(rover: dict[str, str]) -> Iterator[Rover]:
    """The rover; its topics must not fall silent between two tests."""
    publishing = Rover(rover)
    publishing.client.wait_for_coordinator()
    yield publishing
    publishing.close()


@pytest.mark.parametrize(
    ('formula', 'timeout', 'code', 'verdict'),
    [
        ('forall r in Rover: always[0 s, 1 s] Speed[r] < 1.5', '20 s', 0, 'true'),
        ('forall r in Rover: always[0 s, 1 s] Speed[r] < 0.5', '20 s', 1, 'false'),
        ('forall r in Rover: always Speed[r] < 1.5', '1 s', 2, 'undecided'),
    ],
)
def test_a_formula_is_evaluated_from_a_shell(
    rover: dict[str, str], vehicle: Rover, formula: str, timeout: str, code: int, verdict: str
) -> None:
    line = command('dyknow', 'evaluate', formula, '--timeout', timeout, '--json')
    returned, printed = vehicle.run(line, rover)
    answer = json.loads(printed)
    assert (returned, answer['verdict']) == (code, verdict), printed
    assert answer['exit_status'] == ('TIMEOUT' if code == 2 else 'SUCCESS')


def test_the_node_of_the_readme(rover: dict[str, str], vehicle: Rover) -> None:
    vehicle.client.node.create_timer(1.5, lambda: vehicle.tell(charge=0.1))
    returned, printed = vehicle.run(['python3', str(EXAMPLES / 'stop_when_empty.py')], rover)
    assert returned == 0, printed
    assert 'a rover did not stop' in printed
    assert 'Speed[rover1] < 0.1' in printed


def manual_block(words: str) -> str:
    """Return the block of Python in docs/clients.md that contains some words."""
    text = (EXAMPLES.parent / 'clients.md').read_text(encoding='utf-8')
    (block,) = (
        each for each in re.findall(r'```python\n(.*?)```', text, re.DOTALL) if words in each
    )
    return str(block)


def test_the_script_of_the_manual(rover: dict[str, str], vehicle: Rover, tmp_path: Path) -> None:
    script = tmp_path / 'is_all_well.py'
    script.write_text(manual_block('is_all_well'), encoding='utf-8')
    returned, printed = vehicle.run(['python3', str(script)], rover)
    assert returned == 0, printed
    assert printed.startswith('TRUE ')


def test_the_plan_of_the_manual(vehicle: Rover) -> None:
    names: dict[str, Any] = {}
    exec(manual_block('PLAN = Plan('), names)  # noqa: S102

    async def act() -> bool:
        return True

    client = vehicle.client
    task = client.executor.create_task(names['deliver'], client.node, act, act)
    client.spin_until(task.done, 'the end of the plan')
    task.result()
