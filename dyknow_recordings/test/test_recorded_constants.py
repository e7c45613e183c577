"""Constants of message types that a recording defines, which need not be installed."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from small_bags import START, channel, chunk, mcap, schema, stored

from dyknow_recordings import open_recording
from dyknow_recordings.check import main

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
def test_verdicts(
    path: Path, formula: str, verdict: str, capsys: pytest.CaptureFixture[str]
) -> None:
    main([str(path), '--json', '--formula', formula])
    found: dict[str, Any] = json.loads(capsys.readouterr().out)
    (result,) = found['formulas']
    assert result['outcome'] == verdict, result


def test_a_misspelt_constant(path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    formula = 'always "/machine".state = MachineState.STATE_IDEL'
    assert main([str(path), '--json', '--formula', formula]) == 2
    assert "no constant 'STATE_IDEL'; did you mean 'STATE_IDLE'?" in capsys.readouterr().out


def test_constants_of_types(path: Path) -> None:
    with open_recording(path) as opened:
        constants = opened.constants
    assert constants['made_up/msg/MachineState'] == {'STATE_IDLE': 1, 'STATE_BROKEN': 7}
    assert constants['action_msgs/msg/GoalStatus']['STATUS_ABORTED'] == 6
