"""The command line of a benchmark that has several parts."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from typing import Any


def measure(description: str | None, *functions: Callable[..., Any]) -> None:
    """Measure the parts chosen on the command line, and print their results.

    Args:
        description: of the benchmark.
        functions: its parts; each has a parameter `quick` and returns a row or a list of rows.
    """
    parts = {each.__name__: each for each in functions}
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    parser.add_argument('--only', choices=parts, action='append')
    parser.add_argument('--quick', action='store_true', help='shorter and less exact')
    arguments = parser.parse_args()
    found = {name: parts[name](quick=arguments.quick) for name in arguments.only or parts}
    if arguments.json:
        print(json.dumps(found))
        return
    for name, rows in found.items():
        print(name)
        for row in rows if isinstance(rows, list) else [rows]:
            print('  ', row)
