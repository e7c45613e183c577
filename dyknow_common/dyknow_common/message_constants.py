"""Constants of message types by name: `NavSatStatus.STATUS_NO_FIX`.

The types come from the `.msg` files of the sourced workspaces. A type
may be named with its package, `action_msgs/msg/GoalStatus.STATUS_ABORTED`; it must be if several
packages have a type of that name, unless all give the constant the same value.
"""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from collections.abc import Set as AbstractSet
from contextlib import suppress
from difflib import get_close_matches
from functools import cache
from pathlib import Path
from typing import Final, TypeAlias

from dyknow_common.errors import DyKnowError, ExitCode, listed
from dyknow_common.limits import MAX_FILE_BYTES
from dyknow_common.text_files import read_regular
from dyknow_common.values import Value

TypeConstants: TypeAlias = Mapping[str, Mapping[str, Value]]
"""The constants of message types, by the types' names, such as `action_msgs/msg/GoalStatus`."""

_MAX_NAME: Final = 200
"""The number of characters of the name of a type; file systems have limits, too."""

_NAME: Final = re.compile(
    r'(?P<type>(?:[a-z]\w*/msg/)?(?P<base>[A-Z][A-Za-z0-9]*))\.(?P<constant>[A-Z][A-Z0-9_]*)'
)
_DEFINED: Final = re.compile(
    r'^[ \t]*(?P<kind>[a-z]\w*)(?:<=\d+)?[ \t]+(?P<name>[A-Z]\w*)[ \t]*=[ \t]*(?P<value>[^\n]*)$',
    re.MULTILINE,
)
_QUOTED: Final = re.compile(r'"(?:\\.|[^"\\])*"')


def message_constant(name: str, types: TypeConstants | None = None) -> Value | None:
    """Return the value of a constant; None if no type is called so, as the name is another's then.

    Args:
        name: such as `NavSatStatus.STATUS_NO_FIX`.
        types: where to look for it; None: the types that are installed.

    Raises:
        DyKnowError: for a constant that its type does not have, or with several values; for a type
            that is not installed while one of a similar name has the constant.
    """
    match = _NAME.fullmatch(name)
    if match is None:
        return None
    kind, base, constant = match['type'], match['base'], match['constant']
    held_types = _installed(base) if types is None else types
    found = {
        each: constants
        for each, constants in held_types.items()
        if each == kind or (kind == base and each.rpartition('/')[2] == base)
    }
    values = {each: held[constant] for each, held in found.items() if constant in held}
    if values:
        _check_meaning(name, constant, values, found.keys() - values.keys())
        return next(iter(values.values()))
    if found:
        known = [each for held in found.values() for each in held]
        near = get_close_matches(constant, known, n=1)
        hint = f"did you mean '{near[0]}'?" if near else f'there is {listed(known) or "none"}'
        verb = 'have' if len(found) > 1 else 'has'
        message = f"{' and '.join(found)} {verb} no constant '{constant}'; {hint}"
        raise DyKnowError(message, ExitCode.INVALID_ARGUMENT)
    if types is None:
        _check_type(kind, base, constant)
    return None


def _check_meaning(
    name: str, constant: str, values: Mapping[str, Value], others: AbstractSet[str]
) -> None:
    """Raise DyKnowError for a constant that may belong to another type of the same name.

    For example, ABORTED is 4 for actionlib_msgs/msg/GoalStatus, where action_msgs/msg/GoalStatus
    calls another state 4, and has no ABORTED.
    """
    full = listed(f'{each}.{constant}' for each in values)
    if len({(type(each), each) for each in values.values()}) > 1:
        message = f"'{name}' has several values; write one of {full}"
    elif others:
        message = (
            f"'{name}' is no constant of {listed(sorted(others))}; write {full} if you mean it"
        )
    else:
        return
    raise DyKnowError(message, ExitCode.INVALID_ARGUMENT)


def _check_type(kind: str, base: str, constant: str) -> None:
    """Raise DyKnowError for an unknown type if one of a similar name has the constant."""
    for similar in get_close_matches(base, _installed_names(), cutoff=0.8):
        if any(constant in held for held in _installed(similar).values()):
            message = f"there is no message type '{kind}'; did you mean '{similar}.{constant}'?"
            raise DyKnowError(message, ExitCode.INVALID_ARGUMENT)


def constant_names(text: str) -> list[str]:
    """Return what looks like a constant of a message type in a text without its quotations."""
    return list(dict.fromkeys(each[0] for each in _NAME.finditer(_QUOTED.sub('""', text))))


def constants_in(definition: str) -> dict[str, Value]:
    """Return the constants in the text of a `.msg` file."""
    found: dict[str, Value] = {}
    for each in _DEFINED.finditer(definition):
        with suppress(ValueError):
            found[each['name']] = _value(each['kind'], each['value'].strip())
    return found


def _value(kind: str, text: str) -> Value:
    if kind in {'string', 'wstring'}:
        is_quoted = len(text) > 1 and text[0] == text[-1] and text[0] in '"\''
        return text[1:-1] if is_quoted else text
    number = text.partition('#')[0].strip()
    if kind == 'bool':
        return number.lower() in {'true', '1'}
    return float(number) if kind.startswith('float') else int(number, 0)


@cache
def _installed(base: str) -> TypeConstants:
    """Return the constants of the installed types with a name in any package."""
    found: dict[str, Mapping[str, Value]] = {}
    for prefix in sourced_prefixes() if len(base) <= _MAX_NAME else ():
        for path in sorted(prefix.glob(f'share/*/msg/{base}.msg')):
            with suppress(OSError):
                text = read_regular(path, MAX_FILE_BYTES).decode(errors='replace')
                found.setdefault(f'{path.parent.parent.name}/msg/{base}', constants_in(text))
    return found


@cache
def _installed_names() -> frozenset[str]:
    return frozenset(
        path.stem for each in sourced_prefixes() for path in each.glob('share/*/msg/*.msg')
    )


def sourced_prefixes() -> tuple[Path, ...]:
    """Return the prefixes of the workspaces that are sourced."""
    found = os.environ.get('AMENT_PREFIX_PATH', '').split(os.pathsep)
    return tuple(Path(each) for each in found if each)
