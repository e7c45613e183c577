"""Constants of message types that a recording defines, which need not be installed."""

from __future__ import annotations

from pathlib import Path

import pytest
from running_checks import run_check
from small_bags import START, channel, chunk, mcap, schema, stored

from dyknow_recordings import open_recording

DEFINITION = """uint8 STATE_IDLE = 1
uint8 STATE_BROKEN = 7
uint8 state
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    """Three states of a machine, of a type that is not installed."""
    found = tmp_path / 'machine.mcap'
    records = [
        stored(1, START + n * 10_000_000, bytes((0, 1, 0, 0, state)), n)
        for n, state in enumerate((1, 1, 7))
    ]
    types = schema(1, 'made_up/msg/MachineState', DEFINITION) + channel(1, 1, '/machine')
    found.write_bytes(mcap(types, chunk(records, (START, START + 20_000_000))))
    return found


@pytest.mark.parametrize(
    ('formula', 'verdict'),
    [
        ('always "/machine".state = MachineState.STATE_IDLE', 'false'),
        ('eventually "/machine".state = made_up/msg/MachineState.STATE_BROKEN', 'true'),
        ('let good = MachineState.STATE_IDLE in always "/machine".state >= good', 'undecided'),
        (
            'eventually "/machine".state - prev("/machine".state) = Marker.SPHERE_LIST - 1',
            'true',
        ),
    ],
)
def test_verdicts(path: Path, formula: str, verdict: str) -> None:
    (result,) = run_check(path, '--json', '--formula', formula).formulas
    assert result['outcome'] == verdict, result


def test_a_misspelt_constant(path: Path) -> None:
    formula = 'always "/machine".state = MachineState.STATE_IDEL'
    found = run_check(path, '--json', '--formula', formula)
    assert found.code == 2
    assert "no constant 'STATE_IDEL'; did you mean 'STATE_IDLE'?" in found.out


def test_constants_of_types(path: Path) -> None:
    with open_recording(path) as opened:
        constants = opened.constants
    assert constants['made_up/msg/MachineState'] == {'STATE_IDLE': 1, 'STATE_BROKEN': 7}
    assert constants['action_msgs/msg/GoalStatus']['STATUS_ABORTED'] == 6
