"""Drift: values outside of the intervals of a forecast more often than its calibration allows.

A table says `0.95 of 32 blocks of 5 s`: measured in 32 blocks of time, a truth of a new block is
inside with a probability of at least 0.95. So at most one value in each block is compared with the
forecast of it, at another place in each block.

If the new blocks are exchangeable with the measured ones, then the chance that a value is outside
depends on the calibration: with n blocks and a coverage of c, this chance has the distribution
Beta((1 - c)(n + 1), c(n + 1)), and the number of values outside is beta-binomial (Vovk, Conditional
validity of inductive conformal predictors, 2012). A plain binomial test would mistake the luck of a
calibration with few blocks for a drift.
"""

from __future__ import annotations

import math
import re
from collections import deque
from dataclasses import dataclass
from typing import Final

from dyknow_common import format_duration, parse_duration

WINDOW: Final = 100
"""The number of the latest values that count."""

SIGNIFICANCE: Final = 1e-4
"""The chance that a value makes a warning although nothing has changed."""

GAP_PERIODS: Final = 3
"""No value is interpolated in a gap longer than this many periods, and than the step."""

_GOLDEN: Final = (math.sqrt(5) - 1) / 2
"""The multiples of this number are spread evenly, modulo 1."""

_PROMISE: Final = re.compile(
    r'\s*(?P<coverage>[0-9.e-]+) of (?P<blocks>[0-9]{1,9}) blocks of (?P<block>.+)'
)

_Value = tuple[int, float]  # The time, and the value.


@dataclass(frozen=True, slots=True)
class Coverage:
    """The promise of a calibration, `0.95 of 32 blocks of 5 s`.

    Args:
        coverage: the probability of a truth of a new block to be inside, above 0 and below 1.
        blocks: the number of blocks that it was measured with.
        block: their length in nanoseconds.
    """

    coverage: float
    blocks: int
    block: int

    @classmethod
    def parse(cls, text: str) -> Coverage:
        """Return what a text says.

        Raises:
            ValueError: if it is no such text.
        """
        found = _PROMISE.fullmatch(text)
        promise = found and cls(
            float(found['coverage']), int(found['blocks']), parse_duration(found['block'])
        )
        if not promise or not 0 < promise.coverage < 1 or promise.block <= 0:
            raise ValueError(f"'{text}' is no coverage; write it as in '0.95 of 32 blocks of 5 s'")
        return promise

    def __str__(self) -> str:
        return f'{self.coverage!r} of {self.blocks} blocks of {format_duration(self.block)}'

    def chance(self, outside: int, values: int) -> float:
        """Return the probability of at least some values outside, of values in new blocks."""
        weight = self.blocks + 1
        a, b = (1 - self.coverage) * weight, self.coverage * weight
        return math.fsum(
            math.comb(values, k) * math.exp(_log_beta(k + a, values - k + b) - _log_beta(a, b))
            for k in range(outside, values + 1)
        )


def _log_beta(a: float, b: float) -> float:
    return math.lgamma(a) + math.lgamma(b) - math.lgamma(a + b)


class DriftTest:
    """Compares values with the forecast of them, at most one in each block of time.

    Args:
        horizon: how far ahead the forecast is, in nanoseconds.
        step: between the times of the forecast, in nanoseconds.
    """

    def __init__(self, promise: Coverage, horizon: int, step: int) -> None:
        self.warning = ''
        """More values are outside than the calibration allows; empty if they are not."""
        self._promise, self._horizon, self._step = promise, horizon, step
        self._outside: deque[bool] = deque(maxlen=WINDOW)
        self._last: _Value | None = None
        self._period = 0
        self._pending: tuple[int, float, float] | None = None
        self._place = 0.0
        self._next = 0

    def note(self, time: int, value: float, forecast: float, half_width: float) -> None:
        """Take a value and the forecast made from it; ignore a time that is not later."""
        last = self._last
        if last is not None and time <= last[0]:
            return
        self._last = time, value
        if last is not None:
            if self._pending and time >= self._pending[0]:
                self._compare(*self._pending, last, (time, value))
                self._pending = None
            self._period = time - last[0]
        if self._pending is None and time >= self._next and math.isfinite(forecast):
            self._pending = time + self._horizon, forecast, half_width
            place, self._place = self._place, (self._place + _GOLDEN) % 1
            self._next = time + round(self._promise.block * (1 + self._place - place))

    def _compare(
        self, due: int, forecast: float, half_width: float, last: _Value, now: _Value
    ) -> None:
        """Compare a forecast that has come due with the value between the last two."""
        gap = now[0] - last[0]
        if due < now[0] and gap > max(self._step, GAP_PERIODS * self._period):
            return
        truth = last[1] + (now[1] - last[1]) * ((due - last[0]) / gap)
        if math.isfinite(truth):
            error = abs(truth - forecast)
            self._outside.append(error > half_width and not math.isclose(error, half_width))
            self.warning = self._judgement()

    def _judgement(self) -> str:
        outside, values = sum(self._outside), len(self._outside)
        if self._promise.chance(outside, values) >= SIGNIFICANCE:
            return ''
        return (
            f'{outside} of the last {values} values, at most one in each '
            f'{format_duration(self._promise.block)}, were outside of the interval that was '
            f'forecast {format_duration(self._horizon)} before, and '
            f'{1 - self._promise.coverage:.3g} of them may be; calibrate with recordings of now'
        )
