"""Samples, the elements of streams (paper, section III)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from dyknow_common import Value


class PartialFields(dict[str, Value]):
    """Fields of a sample that lacks others.

    Args:
        fields: what it has.
        reasons: why it has not, for each field that it should have.
    """

    def __init__(self, fields: Mapping[str, Value], reasons: Mapping[str, str]) -> None:
        super().__init__(fields)
        self.reasons = reasons

    def __missing__(self, name: str) -> Value:
        raise KeyError(name, self.reasons[name]) if name in self.reasons else KeyError(name)


def missing_text(error: KeyError, otherwise: str = '') -> str:
    """Which field a sample lacks and, as far as that is known, why."""
    name, *reasons = error.args
    return f"no field '{name}'" + (f': {reasons[0]}' if reasons else otherwise)


@dataclass(frozen=True, slots=True)
class Sample:
    """One tuple of a stream.

    Args:
        valid_time: when the information held, in nanoseconds.
        available_time: when the receiver could use it, in nanoseconds; strictly increasing within a
            stream.
        fields: a value for each field name.
    """

    valid_time: int
    available_time: int
    fields: Mapping[str, Value]
