"""The site is built without a fault, and what is generated from the code is up to date."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).parent.parent
PAGES = [*ROOT.glob('*.md'), *(ROOT / 'docs').rglob('*.md'), *(ROOT / 'benchmarks').glob('*.md')]

_FENCED = re.compile(r'^```.*?^```$', re.MULTILINE | re.DOTALL)
_LINK = re.compile(r'\]\((?![a-z]+:)(?P<path>[^)#\s]*)(?:#(?P<anchor>[^)\s]*))?\)')
_HEADING = re.compile(r'^#+ (.*)$', re.MULTILINE)


def run(*command: str) -> Any:
    """Run a tool of the repository with this Python."""
    return subprocess.run(
        [sys.executable, *command],
        cwd=ROOT,
        env={**os.environ, 'NO_MKDOCS_2_WARNING': '1'},
        capture_output=True,
        text=True,
        check=False,
        timeout=220,
    )


@pytest.mark.parametrize('tool', ['make_reference.py', 'make_pictures.py'])
def test_what_is_generated_is_up_to_date(tool: str) -> None:
    done = run(f'tools/{tool}', '--check')
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_site_needs_no_network(tmp_path: Path) -> None:
    pytest.importorskip('mkdocs')
    done = run('-m', 'mkdocs', 'build', '--strict', '--site-dir', str(tmp_path))
    assert done.returncode == 0, done.stderr
    pages = list(tmp_path.rglob('*.html'))
    assert len(pages) > len(PAGES) - 3
    for page in pages:
        text = page.read_text(encoding='utf-8')
        loaded = re.findall(r'<(?:script|img|link)\b[^>]*(?:src|href)="(https?:[^"]*)"', text)
        assert not loaded, page


@cache
def anchors(page: Path) -> set[str]:
    """The anchors of the headings of a page, as GitHub makes them."""
    text = _FENCED.sub('', page.read_text(encoding='utf-8'))
    plain = (re.sub(r'\[([^]]*)\]\([^)]*\)', r'\1', each) for each in _HEADING.findall(text))
    return {re.sub(r'[^\w\- ]', '', each.lower()).replace(' ', '-') for each in plain}


@pytest.mark.parametrize('page', PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_links_lead_somewhere(page: Path) -> None:
    text = re.sub(r'`[^`\n]*`', '', _FENCED.sub('', page.read_text(encoding='utf-8')))
    for link in _LINK.finditer(text):
        target = page.parent / link['path'] if link['path'] else page
        assert target.exists(), link[0]
        if link['anchor'] and target.suffix == '.md':
            assert link['anchor'] in anchors(target), link[0]


def texts_of_the_code() -> Iterator[str]:
    """All texts of packages and scripts, cut where they have values."""
    for path in (*ROOT.glob('dyknow_*/dyknow_*/**/*.py'), ROOT / 'tools' / 'set_up.py'):
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8'))):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                yield node.value
    yield (ROOT / 'env.sh').read_text(encoding='utf-8')


def test_the_messages_of_troubleshooting_are_those_of_the_code() -> None:
    """Each part of a message between names and numbers is a text of the code."""
    page = (ROOT / 'docs' / 'troubleshooting.md').read_text(encoding='utf-8')
    code = '\n'.join(texts_of_the_code())
    messages = re.findall(r'^\| `([^`|]*…[^`|]*)`', page, re.MULTILINE)
    assert len(messages) > 20
    for message in messages:
        for part in filter(None, map(str.strip, re.split('…|; ', message))):
            assert part in code, f'{message}: no text of the code has {part!r}'
