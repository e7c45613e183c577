"""Mutated texts of every language: DyKnow's own errors alone, without long waits."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

SCRIPT = Path(__file__).parent.parent / 'benchmarks' / 'fuzz_languages.py'

INPUTS = int(os.environ.get('DYKNOW_RANDOM_CASES', '0')) or 300
"""The number of texts of each language."""

SEED = 3
"""A seed with which the mutations leave some of so few texts correct, in each language."""


def test_mutated_texts() -> None:
    script = subprocess.run(
        [sys.executable, SCRIPT, f'--inputs={INPUTS}', f'--seed={SEED}', '--json'],
        capture_output=True,
        text=True,
        check=False,
    )
    found = json.loads(script.stdout)
    assert {name: each['examples'] for name, each in found.items() if each['examples']} == {}
    assert script.returncode == 0
    assert all(each['inputs'] == INPUTS for each in found.values())
    assert all(each['accepted'] > 0 for each in found.values())
