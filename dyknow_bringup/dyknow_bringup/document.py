"""YAML documents, read with errors that name the file, the key and the correction."""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from reprlib import Repr
from typing import Any, Final, TypeVar

import yaml

from dyknow_bringup.errors import BringupError
from dyknow_common import ExitCode, parse_duration, read_text

Point = tuple[float, float, float]
"""Coordinates or components along x, y and z (east, north, up)."""

Element = TypeVar('Element')

_SHORT: Final = Repr()
_SHORT.maxlevel = 3
_SHORT.maxstring = _SHORT.maxlong = _SHORT.maxother = 100


@dataclass(frozen=True, slots=True)
class YamlEntry:
    """A value in a YAML file.

    Each method that reads the value raises BringupError if it is something else.

    Args:
        path: the file.
        key: the path from the top of the file to the value, such as `gusts[0].wind`.
        value: the value.
    """

    path: Path
    key: str
    value: Any

    def error(self, correction: str) -> BringupError:
        """Return an error about this value."""
        place = f'{self.path}: {self.key}' if self.key else str(self.path)
        return BringupError(f'{place}: {correction}')

    def mapping(self) -> dict[str, YamlEntry]:
        """Return the entries of a mapping with texts for keys."""
        if not isinstance(self.value, dict) or not all(isinstance(key, str) for key in self.value):
            raise self.error(
                f'write a mapping from names to values instead of {_shown(self.value)}'
            )
        return {key: self._entry(key, value) for key, value in self.value.items()}

    def record(
        self, required: Collection[str], optional: Mapping[str, Any] | None = None
    ) -> dict[str, YamlEntry]:
        """Return the entries of a mapping whose keys are known.

        Args:
            required: keys that must be there.
            optional: other keys, with their default values.
        """
        entries = self.mapping()
        defaults = optional or {}
        known = (*required, *defaults)
        for key, entry in entries.items():
            if key not in known:
                raise entry.error(f'unknown key; the keys here are {", ".join(known)}')
        for key in required:
            if key not in entries:
                raise self.error(f"add the key '{key}'")
        return {key: self._entry(key, value) for key, value in defaults.items()} | entries

    def items(self) -> list[YamlEntry]:
        """Return the entries of a list."""
        if not isinstance(self.value, list):
            raise self.error(f'write a list instead of {_shown(self.value)}')
        return [
            YamlEntry(self.path, f'{self.key}[{index}]', value)
            for index, value in enumerate(self.value)
        ]

    def text(self) -> str:
        """Return a text that is not blank, without the space around it."""
        if not isinstance(self.value, str) or not self.value.strip():
            raise self.error(f'write a text instead of {_shown(self.value)}')
        return self.value.strip()

    def number(self) -> float:
        """Return a finite number."""
        if isinstance(self.value, int | float) and not isinstance(self.value, bool):
            with suppress(OverflowError):
                number = float(self.value)
                if math.isfinite(number):
                    return number
        raise self.error(f'write a number instead of {_shown(self.value)}')

    def whole_number(self) -> int:
        """Return a whole number that is not negative."""
        if not isinstance(self.value, int) or isinstance(self.value, bool) or self.value < 0:
            raise self.error(f'write a whole number from 0 on instead of {_shown(self.value)}')
        return self.value

    def duration(self) -> int:
        """Return a duration that is not negative, in nanoseconds; it must have a unit."""
        if not isinstance(self.value, str):
            raise self.error(f'write a duration, such as 20 s, instead of {_shown(self.value)}')
        try:
            duration = parse_duration(self.value)
        except ValueError as error:
            raise self.error(str(error)) from None
        if duration < 0:
            raise self.error(f"'{self.value}' is negative; write a duration from 0 s on")
        return duration

    def point(self) -> Point:
        """Return three numbers, for x, y and z."""
        x, y, z = self._elements(YamlEntry.number, 3, 'three numbers, [x, y, z]')
        return x, y, z

    def interval(self) -> tuple[int, int]:
        """Return two durations after the start, the earlier one first, in nanoseconds."""
        begin, end = self._elements(YamlEntry.duration, 2, 'two times, [from, to]')
        if end <= begin:
            raise self.error(
                f'the interval {_shown(self.value)} is empty; write the earlier time first'
            )
        return begin, end

    def _elements(
        self, read: Callable[[YamlEntry], Element], count: int, description: str
    ) -> list[Element]:
        elements = [read(entry) for entry in self.items()]
        if len(elements) != count:
            raise self.error(f'write {description}, instead of {_shown(self.value)}')
        return elements

    def _entry(self, key: str, value: Any) -> YamlEntry:
        return YamlEntry(self.path, f'{self.key}.{key}' if self.key else key, value)


def read_document(path: Path) -> YamlEntry:
    """Return the whole of a YAML file.

    Raises:
        BringupError: if the file is missing (NOT_FOUND), cannot be read, or is not YAML.
    """
    if not path.exists():
        others = sorted(sibling.stem for sibling in path.parent.glob(f'*{path.suffix}'))
        hint = f' (there are: {", ".join(others)})' if others else ''
        raise BringupError(f'{path}: no such file{hint}', ExitCode.NOT_FOUND)
    text = read_text(path, 'YAML', BringupError)
    try:
        return YamlEntry(path, '', yaml.safe_load(text))
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        position = f':{mark.line + 1}:{mark.column + 1}' if mark else ''
        raise BringupError(f'{path}{position}: not YAML: {error.problem}') from None
    except yaml.YAMLError as error:
        raise BringupError(f'{path}: not YAML: {error}') from None
    # A number with thousands of digits, a day that does not exist, thousands of brackets.
    except (ValueError, RecursionError) as error:
        raise BringupError(f'{path}: a value cannot be read: {error}') from None


def _shown(value: Any) -> str:
    """Return a value for a message, which may be large, or contain itself."""
    return _SHORT.repr(value)
