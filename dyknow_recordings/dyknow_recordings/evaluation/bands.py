"""Bands of signals: at each state, the interval of an uncertain number, forecast or probability."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final, TypeAlias

import numpy as np
import numpy.typing as npt

from dyknow_common import DyKnowError
from dyknow_reasoning import (
    Bounded,
    Feature,
    ForecastBound,
    ForecastFeature,
    FormulaProbability,
    Probability,
    ReasoningError,
    Sampled,
    Uncertain,
    probability_of,
)

Band: TypeAlias = tuple[npt.NDArray[np.float64], npt.NDArray[np.float64]]
"""The least and the greatest value at each state; NaN where there is none."""

_DEVIATIONS: Final = 1.959964
"""The deviations around the mean that 95 % of a normal distribution are within."""

_TAILS: Final = 0.025, 0.975
"""The shares of the samples below the ends of the band."""


@dataclass(frozen=True, slots=True)
class ForecastBand:
    """The least and the greatest value that a forecast allows until a time."""

    low: Feature
    high: Feature


def forecast_bands(terms: Iterable[Any]) -> dict[str, ForecastBand]:
    """Return the bands of which both bounds are among some terms, by the names of both."""
    found = {str(each): each for each in terms if isinstance(each, Feature)}
    bands: dict[str, ForecastBand] = {}
    for name, low in found.items():
        forecast = ForecastFeature.of(low.name)
        if forecast and forecast.bound is ForecastBound.LOW:
            upper = forecast._replace(bound=ForecastBound.HIGH).name
            high = found.get(str(replace(low, name=upper)))
            if high is not None:
                bands |= dict.fromkeys((name, str(high)), ForecastBand(low, high))
    return bands


def error_band(
    term: Uncertain,
    means: npt.NDArray[np.float64],
    deviations: npt.NDArray[np.float64] | Sequence[Any],
) -> Band:
    """Return where uncertain numbers are: 95 % of the errors, or all within their bounds.

    Args:
        term: the uncertain number.
        means: its best estimates.
        deviations: its deviations or bounds; the texts of its samples.
    """
    if isinstance(term, Sampled):
        ends = np.array([_sample_ends(each) for each in deviations]).reshape(-1, 2)
        return ends[:, 0], ends[:, 1]
    half = np.asarray(deviations) * (1.0 if isinstance(term, Bounded) else _DEVIATIONS)
    return means - half, means + half


def _sample_ends(text: Any) -> tuple[float, float]:
    try:
        low, high = np.quantile(np.array(str(text).split(), np.float64), _TAILS)
    except (ValueError, IndexError):  # They are no numbers, or none: the formula says so.
        return np.nan, np.nan
    return float(low), float(high)


def probability_track(term: Probability) -> ProbabilityTrack | None:
    """Return the track of a term without variables; None if it has no probability."""
    try:
        return ProbabilityTrack(probability_of(f'{term} >= 0', {}))
    except DyKnowError:  # The formula says so.
        return None


class ProbabilityTrack:
    """The interval of a probability at each state.

    Args:
        probability: it has seen no state.

    Attributes:
        is_of_state: True if it depends on no other state.
    """

    def __init__(self, probability: FormulaProbability) -> None:
        self._probability, self.is_of_state = probability, probability.is_of_state

    def band(self, times: Sequence[int], columns: Mapping[str, Sequence[Any]]) -> Band:
        """Take states, given the values of all features; return the intervals."""
        names, rows = list(columns), zip(*columns.values(), strict=True)
        ends = np.array(
            [
                self._ends(time, dict(zip(names, row, strict=True)))
                for time, row in zip(times, rows, strict=True)
            ]
        )
        return ends[:, 0], ends[:, 1]

    def gap(self) -> None:
        """Record that states may be missing before the next one."""
        if not self.is_of_state:
            self._probability.gap()

    def _ends(self, time: int, values: Mapping[str, Any]) -> tuple[float, float]:
        try:
            if not any(each is None or each != each for each in values.values()):  # noqa: PLR0124
                found = self._probability.at_state(time, values).interval()
                return found.lower, found.upper
        except ReasoningError:  # The formula says so.
            pass
        self.gap()
        return np.nan, np.nan
