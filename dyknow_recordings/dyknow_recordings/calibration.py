"""Calibration of forecasts by what came true in recordings, and the rates of their alarms.

The errors are measured by horizon and block of time. Bounds are widened by split conformal
prediction for samples that come in blocks.

The errors of forecasts within one flight are alike: its samples are not exchangeable, so the usual
quantile of all scores promises too much. Blocks of time are assumed to be exchangeable instead. The
quantile gives each block the same weight, however many samples it has, and the unknown next block
the weight of one with infinite scores (Dunn, Wasserman and Ramdas, Distribution-Free Prediction
Sets for Two-Layer Hierarchical Models, 2022; Lee, Barber and Willett, Distribution-free inference
with hierarchical data, 2023). Then a sample of a new block is within the bound with at least the
stated probability, whatever the distribution of the scores is.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from dyknow_common import (
    COMPARISONS,
    MIRRORED_COMPARISONS,
    ORDERS,
    SECOND_NS,
    absence,
    listed_as,
    unit_conversion,
)
from dyknow_configuration import PATH_INPUTS, FeatureForecast, ForecastSource, RequestedFormula
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
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.messages.definitions import MessageTypes
from dyknow_recordings.reading.opening import open_recording
from dyknow_recordings.reading.recording import RecordingReader
from dyknow_stream_processing import GAP_PERIODS, Forecast, load_units

Times = NDArray[np.int64]
Floats = NDArray[np.float64]
Columns = Mapping[str, NDArray[Any]]


@dataclass(frozen=True, slots=True)
class ForecastErrors:
    """Forecasts of one object in one recording, with what came true.

    Args:
        recording: its name.
        times: the times of the messages in nanoseconds; of shape (n,).
        recorded: the value of each message; of shape (n,).
        forecasts: the values at each time of the forecast; NaN without a forecast; of shape (n, k).
        half_widths: their half-widths; of shape (n, k).
        truths: the values that were recorded for these times, interpolated; NaN beyond the end and
            in gaps; of shape (n, k).
        blocks: the number of the block of each message, among the blocks of its recording with
            messages; of shape (n,).
        refused: how often the unit refused its inputs, by the reason.
    """

    recording: str
    times: Times
    recorded: Floats
    forecasts: Floats
    half_widths: Floats
    truths: Floats
    blocks: NDArray[np.int64]
    refused: Mapping[str, int]

    @property
    def scores(self) -> Floats:
        """By how much the half-width is too small; NaN without a forecast or a truth."""
        # Infinite values have no difference.
        with np.errstate(invalid='ignore', over='ignore'):
            found: Floats = np.abs(self.truths - self.forecasts) - self.half_widths
        return found

    def in_blocks(self, parity: int | None) -> NDArray[np.bool_]:
        """Return which messages are in every second block (0 or 1), or in any (None)."""
        if parity is None:
            return np.ones(len(self.times), np.bool_)
        found: NDArray[np.bool_] = self.blocks % 2 == parity
        return found


def block_scores(errors: Iterable[ForecastErrors], parity: int | None) -> list[Floats]:
    """Return the scores of each block, of all objects together: of shape (n, k) each.

    Args:
        errors: the errors of the objects in the recordings.
        parity: 0 or 1 for every second block, None for all.
    """
    found: dict[tuple[str, int], list[Floats]] = {}
    for each in errors:
        chosen, scores = each.in_blocks(parity), each.scores
        for number in np.unique(each.blocks[chosen]).tolist():
            rows = scores[each.blocks == number]
            found.setdefault((each.recording, number), []).append(rows)
    return [np.concatenate(scores) for scores in found.values()]


def widening_of(scores: Iterable[Floats], coverage: float) -> tuple[float, ...]:
    """Return the widening at each time of a forecast, given the scores of blocks.

    Raises:
        RecordingError: for too few blocks.
    """
    blocks = list(scores)
    columns = range(blocks[0].shape[1] if blocks else 1)
    found: list[float] = []
    for column in columns:
        known = [each[~np.isnan(each[:, column]), column] for each in blocks]
        found.append(block_quantile([each for each in known if len(each)], coverage))
    return tuple(found)


def forecast_errors(
    forecast: FeatureForecast, block: int, paths: Iterable[Path], types: MessageTypes
) -> Iterator[ForecastErrors]:
    """Yield the errors of a forecast for each object, in each recording that has its topic.

    Args:
        forecast: as robot.yaml describes it.
        block: the length of a block of time, in nanoseconds.
        paths: the paths of the recordings.
        types: where to find message types that the recordings do not define.

    Raises:
        DyKnowError: for an unreadable recording, or a unit that is not a forecast.
    """
    _made(forecast)
    for path in paths:
        with open_recording(path, types) as recording:
            recorded = {each.name for each in recording.topics if each.message_count}
            errors = [
                _errors(forecast, block, recording, source)
                for source in forecast.sources
                if {*source.topics} <= recorded
            ]
        # Every second number is held out: empty blocks must not count.
        numbers = np.unique(np.concatenate([np.zeros(0, np.int64), *(e.blocks for e in errors)]))
        for each in errors:
            yield replace(each, blocks=np.searchsorted(numbers, each.blocks))


def _errors(
    forecast: FeatureForecast, block: int, recording: RecordingReader, source: ForecastSource
) -> ForecastErrors:
    times, columns = _read(recording, source.topic, source.inputs)
    unit = _made(forecast)
    ticks, fields = times, columns
    if source.path_topic:
        ticks, fields = _with_path(recording, source.path_topic, times, columns)
    shape = (len(ticks), len(unit.times))
    forecasts, half_widths = np.full(shape, np.nan), np.zeros(shape)
    refused: Counter[str] = Counter()
    rows = zip(*(each.tolist() for each in fields.values()), strict=True)
    for index, (time, row) in enumerate(zip(ticks.tolist(), rows, strict=True)):
        try:
            found = unit.forecast(dict(zip(fields, row, strict=True)), time)
        except ValueError as error:
            refused[str(error)] += 1
            continue
        if found is not None:
            forecasts[index], half_widths[index] = found
    return ForecastErrors(
        str(recording.path),
        ticks,
        fields['value'],
        forecasts,
        half_widths,
        _truths(ticks, times, columns['value'], unit.times, forecast.step),
        (ticks - ticks[:1]) // block,
        refused,
    )


def _with_path(
    recording: RecordingReader, topic: str, times: Times, columns: Columns
) -> tuple[Times, Columns]:
    """Return the times at which a forecast of a planned path is made, and its inputs, as `sync`."""
    path_times, path_columns = _read(recording, topic, PATH_INPUTS)
    never, ticks = np.iinfo(np.int64).max, np.union1d(times, path_times)
    ticks = ticks[ticks >= max(times.min(initial=never), path_times.min(initial=never))]
    found = ((times, columns), (path_times, path_columns))
    return ticks, {
        name: each[np.searchsorted(of, ticks, side='right') - 1]
        for of, held in found
        for name, each in held.items()
    }


def _made(forecast: FeatureForecast) -> Forecast:
    unit: Any = load_units().get(forecast.by)
    if not (isinstance(unit, type) and issubclass(unit, Forecast)):
        raise RecordingError(
            f"'{forecast.by}' of '{forecast.feature}' is no forecast that can be calibrated; use "
            'one that comes with DyKnow, or a registered subclass of Forecast'
        )
    settings: Mapping[str, Any] = forecast.settings
    try:
        return unit(horizon=forecast.horizons[-1], step=forecast.step, **settings)
    # The constructor may be user code.
    except Exception as error:
        message = f"the forecast of '{forecast.feature}' cannot be made: {error}"
        raise RecordingError(message) from error


def _read(
    recording: RecordingReader, topic: str, inputs: Mapping[str, str]
) -> tuple[Times, Columns]:
    """Return the valid times of the messages of a topic, in order, and the inputs of a forecast."""
    known = recording.fields(topic)
    for path in inputs.values():
        if listed_as(known, path) is None:
            message_type = recording.contents[topic].message_type
            raise RecordingError(f'{recording.path}: {topic}: {absence(message_type, known, path)}')
    times: list[Times] = []
    values: dict[str, list[NDArray[Any]]] = {name: [] for name in inputs}
    for part in recording.columns({topic: set(inputs.values())}):
        if not part.values:
            continue
        times.append(part.log_times if part.stamps is None else part.stamps)
        for name, path in inputs.items():
            column = part.values[path]
            if not any(isinstance(each, str) for each in column[:1]):
                column = column.astype(np.float64)
                column[list(part.absent.get(path, ()))] = np.nan
            values[name].append(column)
    joined = np.concatenate([np.zeros(0, np.int64), *times])
    # As in a stream, a message that is older than its predecessor counts for nothing.
    newest = np.maximum.accumulate(joined) if len(joined) else joined
    kept = np.concatenate([[True], newest[1:] > newest[:-1]])[: len(joined)] & (joined == newest)
    return joined[kept], {
        name: np.concatenate([np.zeros(0), *each])[kept] for name, each in values.items()
    }


def _truths(ticks: Times, times: Times, recorded: Floats, ahead: Floats, step: int) -> Floats:
    """Return the values at the times of each forecast, interpolated; of shape (n, k)."""
    if len(times) < 2:  # noqa: PLR2004 - there is nothing to interpolate between
        return np.full((len(ticks), len(ahead)), np.nan)
    seconds = (times - times[0]) / SECOND_NS
    wanted = ((ticks - times[0]) / SECOND_NS)[:, np.newaxis] + ahead
    found: Floats = np.interp(wanted, seconds, recorded, right=np.nan)
    after = np.searchsorted(seconds, wanted, side='left').clip(1, len(times) - 1)
    gaps = np.diff(seconds)
    # Of the median period: a recording is known as a whole.
    longest = max(step / SECOND_NS, GAP_PERIODS * float(np.median(gaps)))
    exact = seconds[after] == wanted
    found[(gaps[after - 1] > longest) & ~exact] = np.nan
    return found


def least_blocks(coverage: float) -> int:
    """Return the number of blocks below which no finite bound has a coverage."""
    return math.ceil(round(coverage / (1 - coverage), 9))


def block_quantile(scores: Sequence[Floats], coverage: float) -> float:
    """Return the bound that the scores of a new block do not exceed, with a probability.

    Args:
        scores: the scores of each block that has some; of shape (n,) each.
        coverage: the probability, above 0 and below 1.

    Raises:
        RecordingError: for too few blocks.
    """
    count = len(scores)
    if count < least_blocks(coverage):
        raise RecordingError(
            f'there are {count} blocks of time to calibrate with, and {coverage:.4g} needs '
            f'{least_blocks(coverage)}; give more recordings, or shorter blocks or horizons'
        )
    values = np.concatenate(scores)
    weights = np.concatenate([np.full(len(each), 1 / len(each)) for each in scores])
    order = np.argsort(values, kind='stable')
    # A rounding error of the sum must not choose a smaller value.
    reached = np.cumsum(weights[order]) >= coverage * (count + 1) + 1e-9
    index = int(np.argmax(reached)) if reached.any() else len(order) - 1
    return float(values[order[index]])


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
    """Counts of announcements of a condition, and of how often it came true.

    Args:
        condition: the condition.
        events: the forecasts within whose horizon it came true.
        missed: the events without an alarm.
        calm: the forecasts within whose horizon it did not.
        false: the calm forecasts with an alarm.
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
        forecast: the forecast of the feature.
        unit: the unit of the feature; empty for none.
    """
    found: set[tuple[ForecastFeature, str, float]] = set()
    for formula in formulas:
        for node in walk(parse_formula(formula.text, formula.constants)):
            match node:
                case Comparison(operator, Feature() as feature, Number() | Quantity() as limit):
                    pass
                case Comparison(operator, Number() | Quantity() as limit, Feature() as feature):
                    operator = MIRRORED_COMPARISONS.get(operator, operator)
                case _:
                    continue
            bound = ForecastFeature.of(feature.name)
            if bound is None or bound.feature != forecast.feature or operator not in ORDERS:
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
