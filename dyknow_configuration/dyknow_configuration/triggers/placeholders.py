"""Texts with placeholders for the values of a result.

'formula {name} is {verdict}'    the parts 'formula ', {name}, ' is ', {verdict}
'a brace is written {{'          a brace
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Final

from dyknow_common import Value, ValueType, unknown
from dyknow_configuration.documents.yaml_values import YamlValue

PLACEHOLDERS: Final[Mapping[str, ValueType]] = {
    'name': ValueType.STRING,
    'formula': ValueType.STRING,
    'event': ValueType.STRING,
    'explanation': ValueType.STRING,
    'verdict': ValueType.INT,
    'severity': ValueType.INT,
    'time': ValueType.FLOAT,
    'margin': ValueType.FLOAT,
}
"""The placeholders, with the types of their values in fields of numbers."""

_PART: Final = re.compile(r'\{\{|\}\}|\{([^{}]*)\}|[{}]')


def check_placeholders(value: YamlValue) -> frozenset[str]:
    """Return the placeholders in a text.

    Raises:
        ConfigurationError: at an unknown placeholder, or a single brace.
    """
    text, used = value.text(), set[str]()
    for found in _PART.finditer(text):
        name = found[1]
        if name is not None and name not in PLACEHOLDERS:
            raise value.error(unknown('placeholder', name, PLACEHOLDERS), found.start())
        if found[0] in {'{', '}'}:
            raise value.error(f"write {found[0] * 2} for the character '{found[0]}'", found.start())
        used |= {name} if name is not None else set()
    return frozenset(used)


def single_placeholder(text: str) -> str | None:
    """Return the name of the placeholder that a text consists of; None if it is another text."""
    found = _PART.fullmatch(text.strip())
    return found[1] if found else None


def filled(text: str, values: Mapping[str, Value]) -> str:
    """Return a text with values in the place of its placeholders."""
    return _PART.sub(lambda found: found[0][0] if found[1] is None else str(values[found[1]]), text)
