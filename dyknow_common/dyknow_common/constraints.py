"""Constraints on the times of a stream's samples.

The fields of `StreamConstraints` are the only list of the constraints: the rule of the grammars,
parsing, canonical texts, merging and the conversion of messages follow from them, each by the
`ConstraintKind` of the field.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from enum import Enum, auto
from numbers import Integral
from typing import Any, Final, cast

from dyknow_common.durations import MAX_DURATION_NS, format_duration, parse_duration
from dyknow_common.errors import DyKnowError


class ConstraintKind(Enum):
    """The kind of a constraint's value."""

    TIME = auto()
    DURATION = auto()
    SWITCH = auto()

    @property
    def terminal(self) -> str:
        """The terminal of `common.lark` for values of this kind."""
        return 'TRUTH' if self is ConstraintKind.SWITCH else 'DURATION'

    def parse(self, text: str) -> int:
        """Return the value of a text.

        Raises:
            ValueError: as `parse_duration`.
        """
        return text == 'true' if self is ConstraintKind.SWITCH else parse_duration(text)

    def text(self, value: int) -> str:
        """Return the canonical text of a value, `100 ms`."""
        if self is ConstraintKind.SWITCH:
            return 'true' if value else 'false'
        return format_duration(value)


def _constraint(kind: ConstraintKind, stricter: Callable[[int, int], int] = min) -> Any:
    """Return a field; `stricter` chooses between two values of the constraint."""
    return field(default=None, metadata={'kind': kind, 'stricter': stricter})


@dataclass(frozen=True, slots=True)
class StreamConstraints:
    """Constraints on a stream; times are in nanoseconds, and `None` constrains nothing.

    Args:
        start_time: no sample is valid before it; time since the epoch.
        end_time: no sample is valid after it; time since the epoch.
        max_delay: no sample becomes available later than this after its valid time.
        sample_period: the valid times of two consecutive samples are this far apart, ...
        sample_period_deviation: ... give or take this much; exactly, if it is left out.
        max_lead: no sample becomes available earlier than this before its valid time.
        max_gap: the valid times of two consecutive samples are at most this far apart.
        reorder: True if samples are put in order within `max_delay`, False if they come in order;
            `None`: in order from a topic with one publisher.
        expires: True if the values of a sample are unknown from `max_gap` after it until the next
            one; otherwise a longer distance breaks the constraint.
    """

    start_time: int | None = _constraint(ConstraintKind.TIME, stricter=max)
    end_time: int | None = _constraint(ConstraintKind.TIME)
    max_delay: int | None = _constraint(ConstraintKind.DURATION)
    sample_period: int | None = _constraint(ConstraintKind.DURATION)
    sample_period_deviation: int | None = _constraint(ConstraintKind.DURATION)
    max_lead: int | None = _constraint(ConstraintKind.DURATION)
    max_gap: int | None = _constraint(ConstraintKind.DURATION)
    reorder: bool | None = _constraint(ConstraintKind.SWITCH, stricter=max)
    expires: bool | None = _constraint(ConstraintKind.SWITCH)

    @property
    def is_empty(self) -> bool:
        """True if nothing is constrained."""
        return self == NO_CONSTRAINTS

    @property
    def shortest_period(self) -> int | None:
        """The least distance between the valid times of consecutive samples."""
        if self.sample_period is None:
            return None
        return self.sample_period - (self.sample_period_deviation or 0)

    @property
    def longest_period(self) -> int | None:
        """The greatest distance between the valid times of consecutive samples."""
        if self.sample_period is None:
            return None
        return self.sample_period + (self.sample_period_deviation or 0)

    @property
    def longest_distance(self) -> int | None:
        """The greatest distance that breaks neither `sample_period` nor `max_gap`."""
        max_gap = None if self.expires else self.max_gap
        given = [each for each in (self.longest_period, max_gap) if each is not None]
        return min(given, default=None)

    def given(self) -> dict[str, int]:
        """Return the values that are not `None`, by the names of their constraints."""
        values = {name: getattr(self, name) for name in CONSTRAINT_KINDS}
        return {name: value for name, value in values.items() if value is not None}

    def texts(self) -> dict[str, str]:
        """Return the values that are not `None` as texts, `100 ms`, by the names."""
        return {name: CONSTRAINT_KINDS[name].text(value) for name, value in self.given().items()}

    def merged(self, other: StreamConstraints) -> StreamConstraints:
        """Return the constraints of a stream that keeps both these and the others.

        Raises:
            DyKnowError: if no stream can keep both, or if the result is invalid by itself.
        """
        periods = {self.sample_period, other.sample_period} - {None}
        if len(periods) > 1:
            first, second = (format_duration(each.sample_period or 0) for each in (self, other))
            raise DyKnowError(f'sample_period cannot be both {first} and {second}')
        values: dict[str, Any] = self.given()
        for name, value in other.given().items():
            values[name] = _STRICTER[name](values.get(name, value), value)
        result = StreamConstraints(**values)
        result.validate()
        return result

    def validate(self) -> None:
        """Check that a stream can keep these constraints.

        Raises:
            DyKnowError: as for `validate_values`; or if the stream ends before it starts, a
                deviation has no period or is greater than it, each period is a gap that is too
                long, samples are put in order without a bound of their delay, or values expire at
                no certain time.
        """
        self.validate_values()
        given, text = self.given(), self.texts()
        if {'start_time', 'end_time'} <= given.keys() and given['end_time'] < given['start_time']:
            raise DyKnowError(
                f'end_time ({text["end_time"]}) is before start_time ({text["start_time"]})'
            )
        if self.reorder and self.max_delay is None:
            raise DyKnowError('reorder needs a max_delay beside it')
        if self.expires and (self.max_gap is None or self.max_delay is None):
            raise DyKnowError(
                'expires needs a max_gap beside it, after which a value is unknown, and a '
                'max_delay, after which that is certain'
            )
        if self.expires and self.sample_period is not None:
            raise DyKnowError('a sample_period allows no value to expire; remove one of the two')
        self._check_distances(given, text)

    def validate_values(self) -> None:
        """Check each value by itself.

        Raises:
            DyKnowError: if one is no whole number, negative, too long, or a period or a gap of 0.
        """
        for name, value in self.given().items():
            if not isinstance(cast('object', value), Integral):
                raise DyKnowError(f'{name} is {value!r}; give a whole number of nanoseconds')
            text = CONSTRAINT_KINDS[name].text(value)
            if name in {'sample_period', 'max_gap'} and value <= 0:
                raise DyKnowError(f'{name} is {text}; it must be more than 0')
            if value < 0:
                raise DyKnowError(f'{name} is {text}; it must not be negative')
            if value > MAX_DURATION_NS:
                most = format_duration(MAX_DURATION_NS)
                raise DyKnowError(f'{name} is {text}; it must be at most {most} (68 years)')

    def _check_distances(self, given: Mapping[str, int], text: Mapping[str, str]) -> None:
        if 'sample_period_deviation' in given:
            if 'sample_period' not in given:
                raise DyKnowError('sample_period_deviation needs a sample_period beside it')
            if given['sample_period_deviation'] > given['sample_period']:
                raise DyKnowError(
                    f'sample_period_deviation ({text["sample_period_deviation"]}) is more than '
                    f'sample_period ({text["sample_period"]})'
                )
        shortest = self.shortest_period or 0
        if self.max_gap is not None and self.max_gap < shortest:
            raise DyKnowError(
                f'max_gap ({text["max_gap"]}) is less than the shortest distance that '
                f'sample_period allows ({format_duration(shortest)})'
            )

    def __str__(self) -> str:
        """The canonical text, `max_delay = 100 ms, sample_period = 200 ms`."""
        return ', '.join(f'{name} = {text}' for name, text in self.texts().items())


CONSTRAINT_KINDS: Final = {each.name: each.metadata['kind'] for each in fields(StreamConstraints)}
"""The kind of each constraint, by its name."""

_STRICTER: Final = {each.name: each.metadata['stricter'] for each in fields(StreamConstraints)}

NO_CONSTRAINTS = StreamConstraints()
"""The constraints that every stream keeps."""


def constraint_grammar() -> str:
    """Return the rule `constraint` of all grammars, with a terminal for the names of each kind."""
    names: dict[ConstraintKind, list[str]] = {kind: [] for kind in ConstraintKind}
    for name, kind in CONSTRAINT_KINDS.items():
        names[kind].append(f'"{name}"')
    terminals = {kind: f'{kind.name}_CONSTRAINT' for kind in ConstraintKind}
    lines = [f'{terminals[kind]}: {" | ".join(names[kind])}' for kind in ConstraintKind]
    lines += [f'CONSTRAINT: {" | ".join(terminals.values())}']
    rules = [f'{terminals[kind]} "=" {kind.terminal}' for kind in ConstraintKind]
    return '\n'.join([*lines, f'constraint: {" | ".join(rules)}', ''])
