"""Each recipe of the cookbook passes and is false on the traces that it shows."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from dyknow_command import main

COOKBOOK = Path(__file__).parent.parent / 'docs' / 'cookbook.md'

_RECIPE = re.compile(
    r'^## (?P<name>.*?)\n.*?'
    r'^```formula\n(?P<formula>[^\n]*)\n```\n+'
    r'passes[^\n]*:\n+```csv\n(?P<good>.*?)```\n+'
    r'false at (?P<time>\S+) s[^\n]*\n+```csv\n(?P<bad>.*?)```',
    re.MULTILINE | re.DOTALL,
)

# The only sort of the cookbook.
_DOMAIN = ('--domain', 'Robot=r1,r2')

_SECOND_NS = 1_000_000_000


@dataclass(frozen=True)
class Recipe:
    formula: str
    good: str
    bad: str
    false_at_s: float


def recipes() -> dict[str, Recipe]:
    """The recipes of the page, by their headings."""
    text = COOKBOOK.read_text(encoding='utf-8')
    return {
        each['name']: Recipe(each['formula'], each['good'], each['bad'], float(each['time']))
        for each in _RECIPE.finditer(text)
    }


@pytest.fixture
def check(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> Callable[[str, str], tuple[int, dict[str, Any]]]:
    """Return the exit code of `dyknow check`, and what it says of a formula over a trace."""

    def run(formula: str, trace: str) -> tuple[int, dict[str, Any]]:
        path = tmp_path / 'trace.csv'
        path.write_text(trace, encoding='utf-8')
        domain = _DOMAIN if 'in Robot' in formula else ()
        code = main(['check', str(path), '--formula', formula, '--json', *domain])
        (result,) = json.loads(capsys.readouterr().out)['formulas']
        return code, result

    return run


def test_every_recipe_has_its_traces() -> None:
    text = COOKBOOK.read_text(encoding='utf-8')
    assert len(recipes()) == text.count('```formula') == text.count('```csv') / 2


@pytest.mark.parametrize('name', recipes())
def test_the_recipe_tells_its_traces_apart(
    name: str, check: Callable[[str, str], tuple[int, dict[str, Any]]]
) -> None:
    recipe = recipes()[name]
    code, result = check(recipe.formula, recipe.good)
    assert (code, result['passed']) == (0, True), result
    code, result = check(recipe.formula, recipe.bad)
    assert (code, result['outcome']) == (1, 'false'), result
    (episode,) = result['episodes']
    start = min(float(line.split(',')[0]) for line in recipe.bad.splitlines()[1:])
    decided = (episode['decided_at_ns'] - episode['begin_ns']) / _SECOND_NS + start
    assert decided == pytest.approx(recipe.false_at_s)
