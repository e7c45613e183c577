"""Errors of a forecast over recordings, by horizon and block of time."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from dyknow_common import SECOND_NS, absence, listed_as
from dyknow_configuration import FeatureForecast, ForecastSource
from dyknow_recordings.calibration.conformal import Floats, block_quantile
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.messages.message_types import MessageTypes
from dyknow_recordings.reading.opening import open_recording
from dyknow_recordings.reading.recording import RecordingReader
from dyknow_stream_processing import Forecast, load_units

Times = NDArray[np.int64]

_GAP_PERIODS: Final = 3
"""No truth is interpolated in a gap longer than this many median periods, and than the step."""


@dataclass(frozen=True, slots=True)
class ForecastErrors:
    """Forecasts of one object in one recording, with what came true.

    Args:
        recording: its name.
        times: of the messages in nanoseconds; of shape (n,).
        recorded: the value of each message; of shape (n,).
        forecasts: the values at each time of the forecast; NaN without a forecast; of shape (n, k).
        half_widths: their half-widths; of shape (n, k).
        truths: the values that were recorded for these times, interpolated; NaN beyond the end and
            in gaps; of shape (n, k).
        blocks: the number of the block of each message; of shape (n,).
    """

    recording: str
    times: Times
    recorded: Floats
    forecasts: Floats
    half_widths: Floats
    truths: Floats
    blocks: NDArray[np.int64]

    @property
    def scores(self) -> Floats:
        """By how much the half-width is too small; NaN without a forecast or a truth."""
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
        errors: of the objects in the recordings.
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
        paths: of the recordings.
        types: where to find message types that they do not define.

    Raises:
        DyKnowError: for a recording that cannot be read, or a unit that is no forecast.
    """
    _made(forecast)
    for path in paths:
        with open_recording(path, types) as recording:
            recorded = {each.name for each in recording.topics if each.message_count}
            for source in forecast.sources:
                if source.topic in recorded:
                    yield _errors(forecast, block, recording, source)


def _errors(
    forecast: FeatureForecast, block: int, recording: RecordingReader, source: ForecastSource
) -> ForecastErrors:
    times, columns = _read(recording, source)
    unit = _made(forecast)
    shape = (len(times), len(unit.times))
    forecasts, half_widths = np.full(shape, np.nan), np.zeros(shape)
    rows = zip(*(each.tolist() for each in columns.values()), strict=True)
    for index, (time, row) in enumerate(zip(times.tolist(), rows, strict=True)):
        found = unit.forecast(dict(zip(columns, row, strict=True)), time)
        if found is not None:
            forecasts[index], half_widths[index] = found
    return ForecastErrors(
        str(recording.path),
        times,
        columns['value'],
        forecasts,
        half_widths,
        _truths(times, columns['value'], unit.times, forecast.step),
        (times - times[:1]) // block,
    )


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


def _read(recording: RecordingReader, source: ForecastSource) -> tuple[Times, Mapping[str, Floats]]:
    """Return the valid times of the messages of a topic, in order, and the inputs of a forecast."""
    topic, inputs = source.topic, source.inputs
    known = recording.fields(topic)
    for path in inputs.values():
        if listed_as(known, path) is None:
            message_type = next(
                each.message_type for each in recording.topics if each.name == topic
            )
            raise RecordingError(f'{recording.path}: {topic}: {absence(message_type, known, path)}')
    times: list[Times] = []
    values: dict[str, list[Floats]] = {name: [] for name in inputs}
    for part in recording.columns({topic: set(inputs.values())}):
        if not part.values:
            continue
        times.append(part.log_times if part.stamps is None else part.stamps)
        for name, path in inputs.items():
            column = part.values[path].astype(np.float64)
            column[list(part.absent.get(path, ()))] = np.nan
            values[name].append(column)
    joined = np.concatenate([np.zeros(0, np.int64), *times])
    # As in a stream, a message that is older than its predecessor counts for nothing.
    newest = np.maximum.accumulate(joined) if len(joined) else joined
    kept = np.concatenate([[True], newest[1:] > newest[:-1]])[: len(joined)] & (joined == newest)
    return joined[kept], {
        name: np.concatenate([np.zeros(0), *each])[kept] for name, each in values.items()
    }


def _truths(times: Times, recorded: Floats, ahead: Floats, step: int) -> Floats:
    """Return the values at the times of each forecast, interpolated; of shape (n, k)."""
    if len(times) < 2:  # noqa: PLR2004 - there is nothing to interpolate between
        return np.full((len(times), len(ahead)), np.nan)
    seconds = (times - times[0]) / SECOND_NS
    wanted = seconds[:, np.newaxis] + ahead
    found: Floats = np.interp(wanted, seconds, recorded, right=np.nan)
    after = np.searchsorted(seconds, wanted, side='left').clip(1, len(times) - 1)
    gaps = np.diff(seconds)
    longest = max(step / SECOND_NS, _GAP_PERIODS * float(np.median(gaps)))
    exact = seconds[after] == wanted
    found[(gaps[after - 1] > longest) & ~exact] = np.nan
    return found
