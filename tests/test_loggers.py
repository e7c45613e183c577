"""Calls of loggers: rclpy raises an error if one call in the code has several severities."""

from __future__ import annotations

import ast
from pathlib import Path

ROOT = Path(__file__).parent.parent
SEVERITIES = {'debug', 'info', 'warning', 'error', 'fatal'}


def test_no_call_chooses_its_severity() -> None:
    found = [
        f'{path.relative_to(ROOT)}:{node.lineno}'
        for path in sorted(ROOT.glob('dyknow_*/dyknow_*/**/*.py'))
        for node in ast.walk(ast.parse(path.read_text(encoding='utf-8')))
        if isinstance(node, ast.Call) and isinstance(node.func, ast.IfExp)
        for choice in (node.func.body, node.func.orelse)
        if isinstance(choice, ast.Attribute) and choice.attr in SEVERITIES
    ]
    assert found == []
