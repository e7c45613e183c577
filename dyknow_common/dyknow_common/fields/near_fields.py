"""Fields that a misspelt one may stand for, and the few that a message about it lists.

near_fields(fields, 'twist.linaer.x')   ['twist.twist.linear.x']
overview(fields, 'twist.twist.up')      'twist.twist has: angular, linear'
"""

from __future__ import annotations

import re
from collections.abc import Collection
from difflib import SequenceMatcher
from functools import lru_cache
from typing import Final

from dyknow_common.errors import shortened

_MAX_MEANT: Final = 3
"""The number of fields that are suggested; if more are as near, none is."""

_MAX_LISTED: Final = 5
_MAX_STEPS: Final = 12
_MAX_COMPARED: Final = 200
"""The length of a path that is compared; the time grows with the product of the lengths."""

_SIMILARITY: Final = 0.6
_FUNCTION: Final = re.compile(r'\s*\w+\s*\(([^)]*)\)?')
_OTHER: Final = re.compile(r'\[[^\]]*\]|[^\w.]', re.ASCII)


def near_fields(fields: Collection[str], path: str) -> list[str]:
    """Return the fields whose steps are the most similar to those of a path.

    Their steps contain those of the path in order, as people leave out steps, too.

    Args:
        fields: the listed fields.
        path: an absent path, with selectors and functions or without.

    Returns:
        Up to three; none if no field, or more of them, may be meant.
    """
    names = entry_names(path)
    if len(names) > _MAX_STEPS:
        return []
    fits = {each: _fit(names, entry_names(each)) for each in fields}
    best = max(fits.values(), default=0.0)
    meant = sorted(each for each, fit in fits.items() if fit == best)
    return meant if best and len(meant) <= _MAX_MEANT else []


def overview(fields: Collection[str], path: str) -> str:
    """Return what there is where a path leaves the fields: at most five names."""
    names = entry_names(path)
    known = {each: entry_names(each) for each in fields}
    depth = 0
    while depth < len(names) and any(
        len(each) > depth + 1 and each[: depth + 1] == names[: depth + 1] for each in known.values()
    ):
        depth += 1
    inside = {each: steps for each, steps in known.items() if steps[:depth] == names[:depth]}
    owner = '.'.join(names[:depth])
    shown = sorted(inside)
    if owner or len(shown) > _MAX_LISTED:
        steps = {each[depth] for each in inside.values() if len(each) > depth}
        shown = sorted(steps, key=lambda each: (each == 'header', each)) or shown
    more = len(shown) - _MAX_LISTED
    text = ', '.join(map(shortened, shown[:_MAX_LISTED])) or 'none'
    return f'{owner or "it"} has: {text}{f" and {more} more" if more > 0 else ""}'


def entry_names(path: str) -> tuple[str, ...]:
    """Return the names of the steps of a path, without selectors and functions."""
    if len(path) > _MAX_COMPARED:
        return ()
    call = _FUNCTION.fullmatch(path)
    inner = re.split('[<>=!]', call[1])[0] if call else path
    return tuple(filter(None, _OTHER.sub('', inner).split('.')))


def _fit(names: tuple[str, ...], steps: tuple[str, ...]) -> float:
    """Return how similar names are to steps in the same order; 0 if one is to none."""
    if not names:
        return 0.0
    # The best sums for the names so far, by the number of steps that they may be among.
    sums = [0.0] * (len(steps) + 1)
    for name in names:
        found = [float('-inf')]
        for number, step in enumerate(steps):
            found.append(max(found[-1], sums[number] + _similarity(name, step)))
        sums = found
    return max(0.0, sums[-1])


@lru_cache(maxsize=4096)
def _similarity(name: str, step: str) -> float:
    """Return how similar two names are, up to 1; minus infinity if they are not."""
    ratio = SequenceMatcher(None, name.casefold(), step.casefold()).ratio()
    return ratio if ratio >= _SIMILARITY else float('-inf')
