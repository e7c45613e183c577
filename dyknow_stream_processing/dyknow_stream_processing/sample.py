"""Samples, the elements of streams (paper, section III)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from difflib import SequenceMatcher
from types import MappingProxyType
from typing import Any, Final

from dyknow_common import Alternatives, Value, ValueType

Rows = Sequence[Mapping[str, Value]]
"""The fields of each element of an array."""

MAX_DIGITS: Final = 100
"""The characters of an integer in a message: a longer one may be too large for a float."""

ALTERNATIVES: Final = 'alternatives'
"""The type of a field of a message whose value is one of several."""


def _integer(text: str) -> int:
    if len(text) > MAX_DIGITS:
        raise ValueError
    return int(text)


VALUE_PARSERS: Final[Mapping[str, Callable[[str], Value]]] = {
    ValueType.FLOAT.value: float,
    ValueType.INT.value: _integer,
    ValueType.STRING.value: str,
    ValueType.BOOLEAN.value: {'true': True, 'false': False}.__getitem__,
    ALTERNATIVES: Alternatives,
}
"""Functions that return the value of a field of a message, given as text, by its type.

They raise a KeyError or a ValueError if it has none."""


ELEMENTS_OF_MESSAGE: Final = '; it has: '
"""What precedes the elements of a message in the reason that it lacks one."""


class AbsentElement(str):
    """The reason that a message has no element with a key.

    It is no fault: another publisher of the topic may send the element.
    """

    __slots__ = ()


def nearest_absence(reasons: Iterable[str]) -> str:
    """Return the reason of the message that has the element most like the missing one.

    Other messages of a shared topic, such as those of DyKnow on `/diagnostics`, help nobody.

    Args:
        reasons: why messages lack an element: the missing one, and those that they have.
    """

    def similarity(reason: str) -> float:
        missing, _, known = reason.partition(ELEMENTS_OF_MESSAGE)
        matcher = SequenceMatcher(None, '', missing.rpartition(' = ')[2].strip('"'))
        found = []
        for each in known.split(', '):
            matcher.set_seq1(each)
            found.append(matcher.ratio())
        return max(found)

    return max(reasons, key=similarity)


class PartialFields(dict[str, Value]):
    """Fields of a sample that lacks some of the fields that it should have, or has more than them.

    Args:
        fields: the fields that it has.
        reasons: the reason why each missing field is missing.
        rows: fields of the elements of arrays, by the name that operators use for them.
    """

    def __init__(
        self,
        fields: Mapping[str, Value],
        reasons: Mapping[str, str],
        rows: Mapping[str, Rows] = MappingProxyType({}),
    ) -> None:
        super().__init__(fields)
        if isinstance(fields, PartialFields):
            reasons, rows = {**fields.reasons, **reasons}, {**fields.rows, **rows}
        self.reasons: Mapping[str, str] = reasons
        self.rows: Mapping[str, Rows] = rows

    def __missing__(self, name: str) -> Value:
        raise KeyError(name, self.reasons[name]) if name in self.reasons else KeyError(name)


class WholeMessage(PartialFields):
    """Fields of a message, with the message itself for operators that read all of it.

    Args:
        fields: the fields that operators need.
        message: an object with the fields of the message as attributes.
    """

    def __init__(self, fields: Mapping[str, Value], message: object) -> None:
        super().__init__(fields, getattr(fields, 'reasons', {}))
        self.message: Any = message


def missing_text(error: KeyError, default_reason: str = '') -> str:
    """Return the message about a missing field, with the reason where it is known."""
    name, *reasons = error.args
    return f"no field '{name}'" + (f': {reasons[0]}' if reasons else default_reason)


@dataclass(frozen=True, slots=True)
class Sample:
    """One tuple of a stream.

    Args:
        valid_time: the time at which the information held, in nanoseconds.
        available_time: the time from which the receiver could use it, in nanoseconds; strictly
            increasing within a stream.
        fields: a value for each field name.
        watermark: the time, in nanoseconds, before which no later sample is valid; `None` if the
            producer does not tell.
    """

    valid_time: int
    available_time: int
    fields: Mapping[str, Value]
    watermark: int | None = field(default=None, compare=False)
