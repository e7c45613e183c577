"""The code of the history page, run by node over a document without a browser."""

from __future__ import annotations

import json
import shutil
import subprocess
from importlib import resources
from pathlib import Path
from typing import Any

import pytest

NODE = shutil.which('node')
KNOWN = '2026-09-21 14:13:20.123'


@pytest.fixture(scope='module')
def steps() -> list[dict[str, Any]]:
    if NODE is None:
        pytest.skip('node is not installed')
    page = resources.files('dyknow_dashboard.page')
    script = Path(__file__).with_name('history_page.js')
    line = [NODE, str(script), str(page)]
    done = subprocess.run(line, capture_output=True, text=True, check=True, timeout=120)
    return [json.loads(each) for each in done.stdout.splitlines()]


def test_the_history_page(steps: list[dict[str, Any]]) -> None:
    hidden, shown, who, acknowledged, refused, filtered, fault = steps
    assert hidden['requests'] == []
    assert hidden['texts'][:2] == ['History (2)', '3 kept, 2 not acknowledged']
    assert shown['requests'] == ['api/history?name=&limit=100']
    (row,) = shown['rows']
    assert row[1:] == ['power', 'false', 'p is false', '', 'Acknowledge']
    assert row[0].startswith(KNOWN)
    assert 'p is false\nat 1 s' in row[0], 'what is unfolded'
    assert shown['older']
    assert (who['texts'][3], who['requests']) == ('Say who you are first.', [])
    assert acknowledged['requests'] == [
        'api/acknowledge {"ids":[7],"by":"Ada"}',
        'api/history?name=&limit=100',
    ]
    assert acknowledged['rows'][0][4:] == ['Ada, 2026-09-21 14:13:21.000', 'Clear']
    assert (acknowledged['texts'][0], acknowledged['older']) == ('History', False)
    assert (refused['requests'], refused['texts'][3]) == (
        ['api/clear {"ids":[7]}'],
        'the page is read-only',
    )
    span = 'name=po%26w&from=1774742400000000000&to=1774828800000000000'
    assert filtered['requests'] == [f'api/history?{span}&limit=100']
    assert filtered['step'] == f'api/junit?{span}'
    assert (fault['texts'][2], fault['requests']) == ('the file is damaged', [])
