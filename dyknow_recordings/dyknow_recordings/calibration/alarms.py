"""Rates of false and missed alarms of the comparisons with forecasts in formulas."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from dyknow_common import COMPARISONS, unit_conversion
from dyknow_configuration import FeatureForecast, RequestedFormula
from dyknow_reasoning import (
    Comparison,
    Feature,
    ForecastBound,
    ForecastFeature,
    Number,
    Quantity,
    parse_formula,
    walk,
)
from dyknow_recordings.calibration.measuring import ForecastErrors

_MIRRORED: Mapping[str, str] = {'<': '>', '<=': '>=', '>': '<', '>=': '<='}


@dataclass(frozen=True, slots=True)
class AlarmCondition:
    """A comparison of a bound of a forecast with a constant.

    Args:
        text: for people.
        forecast: the bound.
        operator: `<`, `<=`, `>` or `>=`.
        limit: the constant, in the unit of the messages.
    """

    text: str
    forecast: ForecastFeature
    operator: str
    limit: float


@dataclass(frozen=True, slots=True)
class AlarmRates:
    """How often a condition was announced, and how often it came true.

    Args:
        condition: the condition.
        events: the forecasts within whose horizon it came true.
        missed: those of them without an alarm.
        calm: the forecasts within whose horizon it did not.
        false: those of them with an alarm.
    """

    condition: AlarmCondition
    events: int = 0
    missed: int = 0
    calm: int = 0
    false: int = 0


def conditions_of(
    formulas: Iterable[RequestedFormula], forecast: FeatureForecast, unit: str
) -> Iterator[AlarmCondition]:
    """Yield the comparisons of a forecast with a constant in formulas, each once.

    Args:
        formulas: the formulas.
        forecast: of the feature.
        unit: of the feature; empty for none.
    """
    found: set[tuple[ForecastFeature, str, float]] = set()
    for formula in formulas:
        for node in walk(parse_formula(formula.text, formula.constants)):
            match node:
                case Comparison(operator, Feature() as feature, Number() | Quantity() as limit):
                    pass
                case Comparison(operator, Number() | Quantity() as limit, Feature() as feature):
                    operator = _MIRRORED.get(operator, operator)
                case _:
                    continue
            bound = ForecastFeature.of(feature.name)
            if bound is None or bound.feature != forecast.feature or operator not in _MIRRORED:
                continue
            value = _in_unit(limit, unit, forecast.unit)
            if (bound, operator, value) not in found:
                found.add((bound, operator, value))
                shown = f'{feature.name} {operator} {value:g} {forecast.unit}'.rstrip()
                yield AlarmCondition(shown, bound, operator, value)


def alarm_rates(
    condition: AlarmCondition,
    errors: Iterable[ForecastErrors],
    forecast: FeatureForecast,
    parity: int | None,
) -> AlarmRates:
    """Return the rates of a condition over the forecasts of some blocks of time."""
    steps = condition.forecast.horizon // forecast.step + 1
    widening = np.array(forecast.widening)[:steps]
    compare = COMPARISONS[condition.operator]
    is_high = condition.forecast.bound is ForecastBound.HIGH
    counts = np.zeros((2, 2), np.int64)
    for each in errors:
        widths = np.maximum(each.half_widths[:, :steps] + widening, 0)
        values = each.forecasts[:, :steps]
        bounds = (values + widths).max(axis=1) if is_high else (values - widths).min(axis=1)
        ends = np.searchsorted(each.times, each.times + condition.forecast.horizon, side='right')
        # A window that ends after the recording tells nothing.
        chosen = each.in_blocks(parity) & (ends < len(each.times))
        for row in np.flatnonzero(chosen & ~np.isnan(bounds)).tolist():
            happens = np.any(compare(each.recorded[row : ends[row]], condition.limit))
            counts[int(happens), int(compare(bounds[row], condition.limit))] += 1
    (calm, false), (missed, met) = counts.tolist()
    return AlarmRates(condition, missed + met, missed, calm + false, false)


def _in_unit(limit: Number | Quantity, unit: str, wanted: str) -> float:
    given = limit.unit if isinstance(limit, Quantity) else unit
    convert = unit_conversion(given, wanted) if given and wanted else None
    return float(limit.value if convert is None else convert(limit.value))
