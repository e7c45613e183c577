"""Normal clients beside hostile ones: right verdicts, no lost request, no dead node."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parent.parent / 'benchmarks' / 'soak.py'
MINUTES = 0.1

ROWS = (
    'random_requests',
    'random_goals',
    'killed_client',
    'malformed_source',
)
"""The rows that take turns."""


def test_normal_clients_get_their_verdicts_beside_hostile_ones(tmp_path: Path) -> None:
    options = (
        '--clients=1',
        '--composition',
        f'--minutes={MINUTES}',
        f'--logs={tmp_path}',
    )
    script = subprocess.run(
        [sys.executable, SCRIPT, 'hostile', '--json', *options, '--rows', *ROWS],
        capture_output=True,
        text=True,
        check=False,
    )
    assert script.stdout, script.stderr
    found = json.loads(script.stdout)
    assert found['defects'] == [], json.dumps(found, indent=1)
    assert script.returncode == 0
    # Both sides did something.
    assert any('true at once: true' in each for each in found['normal']['outcomes'])
    assert found['hostile']
