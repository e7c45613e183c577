"""Hooks of the site: pages and links outside of docs/, and diagrams (see mkdocs.yml)."""

import posixpath
import re
import sys
from functools import partial
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / 'tools'))

from sequence_diagram import drawn  # noqa: E402

ROBOTS = ('rover', 'arm', 'handover', 'warehouse')
FILES = ('robot.yaml', 'robot.py', 'expected.yaml')
FLEET_FILES = ('carrier1.yaml', 'basestation.yaml')
TREE_FILES = ('deliver.py', 'formula_behaviours.py')

PAGES = {
    'benchmarks/README.md': 'benchmarks.md',
    'CHANGELOG.md': 'changelog.md',
    'dyknow_bringup/plans/delivery.yaml': 'files/delivery.yaml',
    'examples/README.md': 'robots/index.md',
    **{f'examples/{robot}/README.md': f'robots/{robot}.md' for robot in ROBOTS},
    'examples/fleet/README.md': 'robots/fleet.md',
    'examples/fleet/host.py': 'files/fleet/host.py',
    **{f'dyknow_bringup/robots/fleet/{file}': f'files/fleet/{file}' for file in FLEET_FILES},
    'examples/behaviour_trees/README.md': 'robots/behaviour_trees.md',
    **{f'examples/behaviour_trees/{file}': f'files/trees/{file}' for file in TREE_FILES},
    **{f'examples/{robot}/{file}': f'files/{robot}/{file}' for robot in ROBOTS for file in FILES},
}
"""Files of the repository, and their places in the site."""

_LINK = re.compile(r'\]\(\.\./(?P<path>[^)#]+)(?P<anchor>#[^)]*)?\)')
_LINK_BETWEEN_FILES = re.compile(r'\]\((?!https?:|#)(?P<path>[^)#]+)(?P<anchor>#[^)]*)?\)')
_BLOCK = re.compile(r'^```(?P<language>\w*)\n(?P<text>.*?)^```$', re.MULTILINE | re.DOTALL)
_LINES = ('', 'text', 'formula')
_ALIGNED = (' ', '│', '┃')
_DIAGRAM = re.compile(r'^```mermaid\n(?P<text>.*?)^```$', re.MULTILINE | re.DOTALL)


def on_files(files, *, config):
    """Add the files from outside of docs/."""
    for source, place in PAGES.items():
        text = (ROOT / source).read_text(encoding='utf-8')
        if place.endswith('.md'):
            text = _LINK_BETWEEN_FILES.sub(partial(_relocated, source, place), text)
        files.append(File.generated(config, place, content=text))
    return files


def _relocated(source, place, link):
    """Return a link of a page from outside of docs/, which leads to the place in the site."""
    path = posixpath.normpath(posixpath.join(posixpath.dirname(source), link['path']))
    # mkdocs reports the links that lead nowhere.
    found = PAGES.get(path) or PAGES.get(f'{path}/README.md') or path
    target = found.removeprefix('docs/')
    return f']({posixpath.relpath(target, posixpath.dirname(place))}{link["anchor"] or ""})'


def on_page_markdown(markdown, **_):
    """Lead links that leave docs/ to the places of these files, draw diagrams, wrap long lines."""
    return _BLOCK.sub(_wrapped, _DIAGRAM.sub(_diagram, _LINK.sub(_moved, markdown)))


def _wrapped(block):
    """Return a block of commands, answers or formulas that wraps, unless its lines are aligned."""
    is_aligned = any(line.startswith(_ALIGNED) for line in block['text'].splitlines())
    if is_aligned or block['language'] not in _LINES:
        return block[0]
    return f'``` {{ .text .wrapped }}\n{block["text"]}```'


def _moved(link):
    if link['path'] not in PAGES:
        return link[0]
    return f']({PAGES[link["path"]]}{link["anchor"] or ""})'


def _diagram(block):
    return f'<div class="diagram">\n{drawn(block["text"])}\n</div>'
