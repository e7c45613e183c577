"""The page about limits, whose numbers are the constants that are enforced.

`{common.limits.MAX_FILE_BYTES / MIB}` in limits.md beside this module is 16, as the constant
`MAX_FILE_BYTES` of `dyknow_common.limits` is 16 MiB.
"""

import re
from importlib import import_module
from pathlib import Path

_CONSTANT = re.compile(r'\{([\w.]+)\.(\w+)(?: / (\w+)| - (\d+))?\}')
_SECOND = 10**9
_UNITS = {
    'KIB': 1024,
    'MIB': 1024**2,
    'SECOND': _SECOND,
    'MINUTE': 60 * _SECOND,
    'HOUR': 3600 * _SECOND,
    'DAY': 86_400 * _SECOND,
    'YEAR': 365 * 86_400 * _SECOND,
    'DAY_S': 86_400,
}
_FEW_DIGITS = 10_000


def limits_page():
    """Return the page about limits."""
    text = Path(__file__).with_suffix('.md').read_text(encoding='utf-8')
    return _CONSTANT.sub(_number, text)


def _number(found):
    module, name, unit, less = found.groups()
    value = getattr(import_module(f'dyknow_{module}'), name) - int(less or 0)
    value = value // _UNITS[unit] if unit else value
    return f'{value:,}'.replace(',', ' ') if value >= _FEW_DIGITS else f'{value:g}'
