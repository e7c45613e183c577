"""YAML documents, read with errors that name the file, the key and the mend."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from dyknow_bringup.errors import BringupError
from dyknow_common import ExitCode, parse_duration

Point = tuple[float, float, float]
"""Coordinates or components along x, y and z (east, north, up)."""


@dataclass(frozen=True, slots=True)
class YamlEntry:
    """A value in a YAML file.

    Args:
        path: the file.
        key: how the value is reached from the top of the file, such as `gusts[0].wind`.
        value: what stands there.
    """

    path: Path
    key: str
    value: Any

    def error(self, mend: str) -> BringupError:
        """An error about this value; `mend` says what it should be."""
        place = f'{self.path}: {self.key}' if self.key else str(self.path)
        return BringupError(f'{place}: {mend}')

    def mapping(self) -> dict[str, YamlEntry]:
        """The entries of a mapping, whatever its keys are.

        Raises:
            BringupError: for what is no mapping with texts for keys.
        """
        if not isinstance(self.value, dict) or not all(isinstance(key, str) for key in self.value):
            raise self.error(f'write a mapping from names to values instead of {self.value!r}')
        prefix = f'{self.key}.' if self.key else ''
        return {key: YamlEntry(self.path, prefix + key, value) for key, value in self.value.items()}

    def record(
        self, required: Collection[str], optional: Collection[str] = ()
    ) -> dict[str, YamlEntry]:
        """The entries of a mapping whose keys are known.

        Raises:
            BringupError: for what is no mapping, a missing key, or a key that means nothing.
        """
        entries = self.mapping()
        known = (*required, *optional)
        for key, entry in entries.items():
            if key not in known:
                raise entry.error(f'unknown key; the keys here are {", ".join(known)}')
        for key in required:
            if key not in entries:
                raise self.error(f"add the key '{key}'")
        return entries

    def items(self) -> list[YamlEntry]:
        """The entries of a list.

        Raises:
            BringupError: for what is no list.
        """
        if not isinstance(self.value, list):
            raise self.error(f'write a list instead of {self.value!r}')
        return [
            YamlEntry(self.path, f'{self.key}[{index}]', value)
            for index, value in enumerate(self.value)
        ]

    def text(self) -> str:
        """A text that is not blank, without space around it.

        Raises:
            BringupError: for anything else.
        """
        if not isinstance(self.value, str) or not self.value.strip():
            raise self.error(f'write a text instead of {self.value!r}')
        return self.value.strip()

    def number(self) -> float:
        """A finite number.

        Raises:
            BringupError: for anything else.
        """
        number = isinstance(self.value, int | float) and not isinstance(self.value, bool)
        if not number or not math.isfinite(self.value):
            raise self.error(f'write a number instead of {self.value!r}')
        return float(self.value)

    def whole_number(self) -> int:
        """A whole number that is not negative.

        Raises:
            BringupError: for anything else.
        """
        if not isinstance(self.value, int) or isinstance(self.value, bool) or self.value < 0:
            raise self.error(f'write a whole number from 0 on instead of {self.value!r}')
        return self.value

    def duration(self) -> int:
        """A duration that is not negative, in nanoseconds.

        Raises:
            BringupError: for what is no duration with a unit, or a negative one.
        """
        if not isinstance(self.value, str):
            raise self.error(f'write a duration, such as 20 s, instead of {self.value!r}')
        try:
            duration = parse_duration(self.value)
        except ValueError as error:
            raise self.error(str(error)) from None
        if duration < 0:
            raise self.error(f"'{self.value}' is negative; write a duration from 0 s on")
        return duration

    def point(self) -> Point:
        """Three numbers, for x, y and z.

        Raises:
            BringupError: for anything else.
        """
        numbers = [entry.number() for entry in self.items()]
        try:
            x, y, z = numbers
        except ValueError:
            raise self.error(f'write three numbers, [x, y, z], instead of {self.value!r}') from None
        return x, y, z

    def interval(self) -> tuple[int, int]:
        """Two durations after the start, the earlier one first, in nanoseconds.

        Raises:
            BringupError: for anything else.
        """
        times = [entry.duration() for entry in self.items()]
        try:
            begin, end = times
        except ValueError:
            raise self.error(f'write two times, [from, to], instead of {self.value!r}') from None
        if end <= begin:
            raise self.error(f'the interval {self.value!r} is empty; write the earlier time first')
        return begin, end


def read_document(path: Path) -> YamlEntry:
    """The whole of a YAML file.

    Raises:
        BringupError: for a file that is not there, cannot be read, or is no YAML.
    """
    try:
        return YamlEntry(path, '', yaml.safe_load(path.read_text(encoding='utf-8')))
    except FileNotFoundError:
        raise _not_found(path) from None
    except (OSError, UnicodeDecodeError) as error:
        raise BringupError(f'{path}: cannot be read: {error}') from None
    except yaml.MarkedYAMLError as error:
        raise BringupError(f'{path}{_place(error)}: not YAML: {error.problem}') from None
    except yaml.YAMLError as error:
        raise BringupError(f'{path}: not YAML: {error}') from None


def _place(error: yaml.MarkedYAMLError) -> str:
    mark = error.problem_mark
    return f':{mark.line + 1}:{mark.column + 1}' if mark else ''


def _not_found(path: Path) -> BringupError:
    there = sorted(sibling.stem for sibling in path.parent.glob(f'*{path.suffix}'))
    hint = f' (there are: {", ".join(there)})' if there else ''
    return BringupError(f'{path}: no such file{hint}', ExitCode.NOT_FOUND)
