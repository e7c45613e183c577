"""The command line of a benchmark that has several parts; reports, and costs, of others."""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import threading
from collections.abc import Callable, Mapping
from pathlib import Path
from time import process_time
from typing import Any, NoReturn

EXIT_TIMEOUT_S = 20.0


def measure(
    description: str | None,
    *functions: Callable[..., Any],
    **options: float | str | Path | list[int],
) -> None:
    """Measure the parts chosen on the command line, and print their results.

    Args:
        description: of the benchmark.
        functions: its parts; each has the parameter `quick` and one for each further option, and
            returns a row or a list of rows.
        options: further options of the command line, with their defaults; one whose default is a
            list takes several numbers.
    """
    parts = {each.__name__: each for each in functions}
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    parser.add_argument('--only', choices=parts, action='append')
    parser.add_argument('--quick', action='store_true', help='shorter and less exact')
    for name, default in options.items():
        how: dict[str, Any] = {'type': type(default)}
        if isinstance(default, list):
            how = {'type': int, 'nargs': '+'}
        help_ = f'(default: {default or "none"})'
        parser.add_argument(f'--{name}', default=default, help=help_, **how)
    arguments = parser.parse_args()
    given = {name: getattr(arguments, name) for name in ('quick', *options)}
    found = {name: parts[name](**given) for name in arguments.only or parts}
    if arguments.json:
        print(json.dumps(found))
        return
    for name, rows in found.items():
        print(name)
        for row in rows if isinstance(rows, list) else [rows]:
            print('  ', row)


def print_report(found: Mapping[str, Any], *, as_json: bool) -> None:
    """Print what was found: one JSON object, or a line for each of its values."""
    if as_json:
        print(json.dumps(found), flush=True)
        return
    for name, value in found.items():
        print(f'{name}: {value}', flush=True)


def processor_times(run: Callable[[], object], repetitions: int) -> list[float]:
    """Return the processor time of each of some calls, in seconds."""
    times = []
    for _ in range(repetitions):
        begin = process_time()
        run()
        times.append(process_time() - begin)
    return times


def ask_peers(python: str, task: str, **arguments: Any) -> dict[str, Any]:
    """Return what other tools find for a task of peers.py, in the environment of a Python."""
    done = subprocess.run(
        [python, str(Path(__file__).with_name('peers.py'))],
        input=json.dumps([task, arguments]),
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def end(broken: bool) -> NoReturn:  # noqa: FBT001
    """End also if the middleware waits for something that a killed process held."""
    watch = threading.Timer(EXIT_TIMEOUT_S, os._exit, (int(broken),))
    watch.daemon = True
    watch.start()
    raise SystemExit(int(broken))
