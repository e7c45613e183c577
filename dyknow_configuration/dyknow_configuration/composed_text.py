"""Texts that are made from parts of a YAML document, with errors at the place of the part.

The `topic` and the `field` of a robot.yaml become parts of an annotation. If the annotation does
not parse, the error shows the part that is at fault, in the YAML file.
"""

from __future__ import annotations

import re
from bisect import bisect_right
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, Final, Self

from dyknow_common import (
    CONSTRAINT_KINDS,
    NOWHERE,
    ConstraintKind,
    DyKnowError,
    LanguageError,
    StreamConstraints,
    TextPosition,
    unknown,
)
from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.yaml_values import YamlValue

PLACEHOLDER: Final = re.compile(r'\{(?P<name>[^{}\n]*)\}')
"""Stands for an object in a text: `/{r}/odom`."""


_POSITION: Final = re.compile(r'\bat (?P<line>\d+):(?P<column>\d+)\b')
"""A position in a text that a message names: `from its use at 1:8`."""


class ComposedText:
    """A text that grows by parts. All methods that add something return the text itself."""

    def __init__(self) -> None:
        self._parts: list[str] = []
        self._starts: list[int] = []
        self._origins: list[tuple[YamlValue, int | None]] = []

    def __str__(self) -> str:
        return ''.join(self._parts)

    def __len__(self) -> int:
        return self._starts[-1] + len(self._parts[-1]) if self._parts else 0

    def add(self, text: str, origin: YamlValue, first: int | None = None) -> Self:
        """Add a text.

        Args:
            text: the text.
            origin: the value that it comes from.
            first: the index of its first character in the value; None if the text as a whole
                stands for the value.
        """
        self._starts.append(len(self))
        self._origins.append((origin, first))
        self._parts.append(text)
        return self

    def add_parts(self, parts: Iterable[tuple[str, YamlValue]]) -> Self:
        """Add texts, each of which as a whole stands for its value."""
        for text, origin in parts:
            self.add(text, origin)
        return self

    def add_value(self, value: YamlValue) -> Self:
        """Add a text of the document unchanged."""
        return self.add(value.text(), value, 0)

    def add_template(self, value: YamlValue, objects: Mapping[str, str]) -> Self:
        """Add a text of the document with objects in the place of `{variable}`.

        Raises:
            ConfigurationError: if it has another variable.
        """
        text = value.text()
        variables(value, tuple(objects))
        end = 0
        for found in PLACEHOLDER.finditer(text):
            self.add(text[end : found.start()], value, end)
            self.add(objects[found['name'].strip()], value, found.start())
            end = found.end()
        return self.add(text[end:], value, end)

    @contextmanager
    def errors(self) -> Iterator[None]:
        """Raise each `LanguageError` about the text in a block as an error in the document."""
        try:
            yield
        except LanguageError as error:
            raise self._error(error.reason, error.position) from None

    def _error(self, reason: str, position: TextPosition) -> ConfigurationError:
        if position == NOWHERE:
            return self._origins[0][0].error(reason)
        origin, character = self._origin(position)
        return origin.error(_POSITION.sub(self._mapped, reason), character)

    def _mapped(self, found: re.Match[str]) -> str:
        """Return a position that a message names as one in the document."""
        origin, character = self._origin(TextPosition(int(found['line']), int(found['column'])))
        return f'at {origin.position(character)}'

    def _origin(self, position: TextPosition) -> tuple[YamlValue, int]:
        """Return the value that a part of the text comes from, and the index in it."""
        lines = str(self).split('\n')[: position.line - 1]
        offset = sum(len(each) + 1 for each in lines) + position.column - 1
        part = bisect_right(self._starts, min(offset, len(self))) - 1
        origin, first = self._origins[part]
        return origin, 0 if first is None else first + offset - self._starts[part]


def variables(value: YamlValue, known: Collection[str]) -> frozenset[str]:
    """Return the variables of a template.

    Raises:
        ConfigurationError: if one is unknown.
    """
    found = list(PLACEHOLDER.finditer(value.text()))
    for each in found:
        if (name := each['name'].strip()) not in known:
            raise value.error(unknown('variable', name, known), each.start())
    return frozenset(each['name'].strip() for each in found)


_READERS: Final[Mapping[ConstraintKind, Callable[[YamlValue], int]]] = {
    ConstraintKind.TIME: YamlValue.duration,
    ConstraintKind.DURATION: YamlValue.duration,
    ConstraintKind.SWITCH: YamlValue.truth,
}


def constraint_value(name: str, value: YamlValue) -> int:
    """Return the value of a constraint; durations are in nanoseconds.

    Raises:
        ConfigurationError: if no stream can have it, whatever other constraints it has.
    """
    found = _READERS[CONSTRAINT_KINDS[name]](value)
    given: dict[str, Any] = {name: found}
    try:
        StreamConstraints(**given).validate_values()
    except DyKnowError as error:
        raise value.error(error.message) from None
    return found


def _constraint_text(name: str, value: YamlValue) -> str:
    found = constraint_value(name, value)
    return value.line() if value.is_text else CONSTRAINT_KINDS[name].text(found)


def constraint_texts(stated: Mapping[str, YamlValue]) -> dict[str, str]:
    """Return the constraints that are among some keys, with their values in SSL."""
    return {
        name: _constraint_text(name, each)
        for name, each in stated.items()
        if name in CONSTRAINT_KINDS
    }


def constraint_parts(
    stated: Mapping[str, YamlValue], origin: YamlValue, **defaults: str
) -> tuple[tuple[str, YamlValue], ...]:
    """Return the constraints of a stream that are among some keys, ` with max_gap = 1 s`.

    They are parts of a text, each with its value.

    Args:
        stated: the values by key.
        origin: the value that stands for the defaults.
        defaults: the constraints that are not stated.
    """
    texts = constraint_texts(stated)
    # An error about several is shown at the first.
    found = {**texts, **defaults, **texts}
    return tuple(
        (f'{", " if index else " with "}{name} = {text}', stated.get(name, origin))
        for index, (name, text) in enumerate(found.items())
    )
