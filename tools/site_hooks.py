"""Hooks of the site: pages and links outside of docs/, and diagrams (see mkdocs.yml)."""

import re
import sys
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parent.parent
sys.path.insert(0, str(ROOT / 'tools'))

from sequence_diagram import drawn  # noqa: E402

PAGES = {
    'benchmarks/README.md': 'benchmarks.md',
    'CHANGELOG.md': 'changelog.md',
    'dyknow_bringup/plans/delivery.yaml': 'files/delivery.yaml',
}
"""Files of the repository, and their places in the site."""

_LINK = re.compile(r'\]\(\.\./(?P<path>[^)#]+)(?P<anchor>#[^)]*)?\)')
_DIAGRAM = re.compile(r'^```mermaid\n(?P<text>.*?)^```$', re.MULTILINE | re.DOTALL)


def on_files(files, *, config):
    """Add the files from outside of docs/."""
    for source, place in PAGES.items():
        text = (ROOT / source).read_text(encoding='utf-8')
        # The links of these pages are relative to the root of the repository.
        files.append(File.generated(config, place, content=text.replace('](docs/', '](')))
    return files


def on_page_markdown(markdown, **_):
    """Lead links that leave docs/ to the places of these files, and draw the diagrams."""
    return _DIAGRAM.sub(_diagram, _LINK.sub(_moved, markdown))


def _moved(link):
    if link['path'] not in PAGES:
        return link[0]
    return f']({PAGES[link["path"]]}{link["anchor"] or ""})'


def _diagram(block):
    return f'<div class="diagram">\n{drawn(block["text"])}\n</div>'
