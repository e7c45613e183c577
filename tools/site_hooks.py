"""Bring files from outside of docs/ into the site, and lead links to them there (see mkdocs.yml)."""

import re
from pathlib import Path

from mkdocs.structure.files import File

ROOT = Path(__file__).parent.parent

PAGES = {
    'benchmarks/README.md': 'benchmarks.md',
    'CHANGELOG.md': 'changelog.md',
    'dyknow_bringup/plans/delivery.yaml': 'files/delivery.yaml',
}
"""Files of the repository, and their places in the site."""

_LINK = re.compile(r'\]\((?P<path>[^)#:]+)(?P<anchor>#[^)]*)?\)')


def on_files(files, *, config):
    """Add the files from outside of docs/."""
    for source, place in PAGES.items():
        text = (ROOT / source).read_text(encoding='utf-8')
        # Relative links of these pages are to the root of the repository or to docs/.
        files.append(File.generated(config, place, content=text.replace('](docs/', '](')))
    return files


def on_page_markdown(markdown, *, page, config, files):  # noqa: ARG001 - names of mkdocs
    """Lead links that leave docs/ to the places of these files in the site."""
    return _LINK.sub(_moved, markdown)


def _moved(link):
    outside = link['path'].removeprefix('../')
    if not link['path'].startswith('../') or outside not in PAGES:
        return link[0]
    return f']({PAGES[outside]}{link["anchor"] or ""})'
