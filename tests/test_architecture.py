"""The maintainers' page names files and names that exist."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent

MOST_FILES = {
    'a constraint': 5,
    'an operator of the past': 5,
    'a kind of trigger': 3,
    'a field of an evaluation': 5,
    'a format of recordings': 1,
    'a verb of the command `dyknow`': 1,
}
"""The files that usual changes need, but for new ones; another column has what they may want."""

_FILE = re.compile(
    r'`(\w+/[\w/.]+\.(?:py|lark|msg|owl|txt|json|js))`(?: \(((?:`[^`]+`(?:, )?)+)\))?'
)


def _files_of_changes() -> list[tuple[str, str]]:
    """The files and the names in parentheses of the table of changes."""
    return _FILE.findall(_table())


def _table() -> str:
    text = (ROOT / 'docs' / 'architecture.md').read_text(encoding='utf-8')
    return text.partition('## Where to make which change')[2]


@pytest.mark.parametrize(('path', 'names'), _files_of_changes())
def test_the_table_of_changes_names_what_is_there(path: str, names: str) -> None:
    package = path.partition('/')[0]
    folder = ROOT if package in {'dyknow_interfaces', 'docs', 'tests', 'tools'} else ROOT / package
    text = (folder / path).read_text(encoding='utf-8')
    for name in re.findall(r'`([^`]+)`', names):
        assert re.search(rf'\b{re.escape(name)}\b', text), name


@pytest.mark.parametrize('change', MOST_FILES)
def test_usual_changes_touch_few_files(change: str) -> None:
    (row,) = (row for row in _table().splitlines() if row.startswith(f'| {change} |'))
    files = _FILE.findall(row.split(' | ')[1])
    assert 0 < len(files) <= MOST_FILES[change]


def test_the_table_of_changes_has_the_usual_changes() -> None:
    assert len(_files_of_changes()) > 60
