"""Which features may be unknown at a state, and between which bounds they lie then."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import inf
from typing import Any, Final, TypeAlias

from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.progression.atoms import Values

Range: TypeAlias = tuple[float, float]
"""The least and the greatest value of a number."""

ANY_NUMBER: Range = -inf, inf


@dataclass(frozen=True, slots=True)
class UnknownFeatures:
    """The features that may be unknown: absent from a state, None, or not a number.

    Args:
        ranges: the least and the greatest value of each numeric feature, by name, `Charge`;
            `ANY_NUMBER` for a feature without bounds, or of another kind.
        all_may_be: True if features that are not in `ranges` may be unknown, too.
    """

    ranges: Mapping[str, Range] = field(default_factory=dict)
    all_may_be: bool = False

    def __bool__(self) -> bool:
        return self.all_may_be or bool(self.ranges)

    def range_of(self, name: str) -> Range:
        """Return the bounds of a ground feature."""
        return self.ranges.get(_feature(name), ANY_NUMBER)

    def may_be(self, name: str) -> bool:
        """Return True if a ground feature may be unknown."""
        return self.all_may_be or _feature(name) in self.ranges

    def marked(self, names: Iterable[str], values: Values) -> Values:
        """Return the values of a state, with an UnknownValueError for each unknown value."""
        found: dict[str, Any] = dict(values)
        found.update({name: UnknownValueError(name) for name in self.among(names, values)})
        return found

    def among(self, names: Iterable[str], values: Values) -> list[str]:
        """Return the ground features that are unknown at a state."""
        return [name for name in names if is_unknown(values.get(name)) and self.may_be(name)]


ALL_KNOWN: Final = UnknownFeatures()


class UnknownValueError(ReasoningError):
    """A value is needed, but unknown.

    Args:
        name: the ground feature.
        bounds: the bounds of the value at this state; None: the bounds of the feature.
    """

    def __init__(self, name: str, bounds: Range | None = None) -> None:
        super().__init__(f"the value of '{name}' is unknown")
        self.name, self.bounds = name, bounds


def is_unknown(value: Any) -> bool:
    """Return True for None and NaN; only NaN differs from itself."""
    return value is None or bool(value != value)  # noqa: PLR0124


def _feature(name: str) -> str:
    return name if name.startswith('"') else name.partition('[')[0]
