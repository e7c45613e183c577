"""Write pages of docs/ from the code: commands, nodes, interfaces, Python API, limits, recipes.

Run it after a change of an option, a parameter, a service, a docstring of the Python API, a limit
or a recipe. With --check, it names the pages that are out of date and writes nothing.
"""

import argparse
import sys
from pathlib import Path

from reference.commands import commands_page
from reference.interfaces import interfaces_page
from reference.limits import limits_page
from reference.nodes import nodes_page
from reference.python_api import python_page
from reference.recipes import recipes_page

FOLDER = Path(__file__).parent.parent / 'docs'

PAGES = {
    'reference/commands.md': commands_page,
    'reference/interfaces.md': interfaces_page,
    'reference/nodes.md': nodes_page,
    'reference/python.md': python_page,
    'limits.md': limits_page,
    'recipes.md': recipes_page,
}


def main():
    """Write or check all pages; return 1 if one is out of date."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--check', action='store_true', help='write nothing')
    options = parser.parse_args()
    outdated = []
    for name, make_page in PAGES.items():
        path, text = FOLDER / name, make_page()
        if path.exists() and path.read_text(encoding='utf-8') == text:
            continue
        outdated.append(name)
        if not options.check:
            path.write_text(text, encoding='utf-8')
    if options.check and outdated:
        print(f'run python tools/make_reference.py: {", ".join(outdated)} out of date')
    return int(options.check and bool(outdated))


if __name__ == '__main__':
    sys.exit(main())
