"""Mutated texts of every language: DyKnow's own errors alone, without long waits."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).parent.parent / 'benchmarks' / 'fuzz_languages.py'
INPUTS = 600


@pytest.mark.parametrize(
    'languages',
    [
        ('formula',),
        ('stream',),
        ('annotation', 'concept', 'bridges', 'unit'),
        ('duration', 'field_path', 'name', 'trace', 'scenario', 'plan', 'formulas'),
    ],
    ids=' '.join,
)
def test_mutated_texts(languages: tuple[str, ...]) -> None:
    chosen = [f'--language={language}' for language in languages]
    script = subprocess.run(
        [sys.executable, SCRIPT, f'--inputs={INPUTS}', '--json', *chosen],
        capture_output=True,
        text=True,
        check=False,
    )
    found = json.loads(script.stdout)
    assert {name: each['examples'] for name, each in found.items()} == {
        key: {} for key in languages
    }
    assert script.returncode == 0
    assert all(each['inputs'] == INPUTS for each in found.values())
    # The mutations leave some texts correct.
    assert all(each['accepted'] > 0 for each in found.values())
