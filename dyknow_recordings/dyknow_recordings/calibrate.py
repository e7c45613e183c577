"""The command `dyknow calibrate`: the errors of forecasts over recordings, without ROS."""

from __future__ import annotations

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import numpy as np

from dyknow_common import duration_option, format_duration, replace_text
from dyknow_common.executables import FALSE, SUCCESS, describe
from dyknow_configuration import (
    FeatureForecast,
    RobotConfiguration,
    read_robot,
    table_text,
    write_errors,
)
from dyknow_recordings.calibration import (
    AlarmRates,
    Floats,
    ForecastErrors,
    alarm_rates,
    block_scores,
    conditions_of,
    forecast_errors,
    widening_of,
)
from dyknow_recordings.errors import RecordingError
from dyknow_recordings.reading.opening import add_reading_options, message_types
from dyknow_stream_processing import Coverage

_SIGMAS: Final = 2
"""The standard deviations by which a measured coverage may be below the wanted one by chance."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """The calibration of one forecast.

    Args:
        forecast: with its widening.
        samples: the number of forecasts that it was measured with.
        blocks: the number of their blocks of time.
        held_out: the number of blocks that it was tested with.
        inside: for each time of the forecast, the share of held-out truths inside the bounds.
        whole: the share of held-out forecasts with all truths inside the bounds.
        alarms: the alarms of the comparisons in formulas.
    """

    forecast: FeatureForecast
    samples: int
    blocks: int
    held_out: int
    inside: Floats
    whole: float
    alarms: tuple[AlarmRates, ...] = ()

    def is_short_of(self, coverage: float) -> bool:
        """Return True if the held-out truths do not show that it was reached."""
        chance = _SIGMAS * math.sqrt(coverage * (1 - coverage) / max(self.held_out, 1))
        return not np.all(self.inside >= coverage - chance)


def add_calibrate_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of the command."""
    parser.set_defaults(command=calibrate)
    describe(
        parser,
        'Compare the forecasts of a robot.yaml with what came true in recordings, and write by how '
        'much each is widened into the tables that the file names. Every second block of time '
        'tests what the others gave, or other recordings do.',
        (
            'dyknow calibrate robot.yaml flight1.mcap flight2.mcap',
            'dyknow calibrate robot.yaml flight1.mcap --held-out flight2.mcap',
        ),
        '0 if the tables are written, 1 if the held-out truths are inside less often than wanted, '
        '2 for an error',
    )
    _add_inputs(parser)
    parser.add_argument(
        '--coverage',
        type=_probability,
        default=0.95,
        metavar='P',
        help='the part of the truths that must be inside (default: 0.95)',
    )
    parser.add_argument(
        '--block',
        type=_block,
        metavar='TIME',
        help='the length of a block of time (default: the last horizon of each forecast)',
    )


def _add_inputs(parser: argparse.ArgumentParser) -> None:
    parser.add_argument('robot', type=Path, help='robot.yaml, with forecasts that name tables')
    parser.add_argument('recording', nargs='+', type=Path, help='recordings to measure with')
    parser.add_argument(
        '--held-out',
        nargs='+',
        action='extend',
        type=Path,
        default=[],
        metavar='FILE',
        help='recordings to test with (default: every second block of the others)',
    )
    add_reading_options(parser)


def calibrate(options: argparse.Namespace) -> int:
    """Calibrate the forecasts of a robot.yaml, and print how good they are; return the exit code.

    Raises:
        DyKnowError: for a file that cannot be read or written, or too little to calibrate with.
    """
    robot = read_robot(options.robot, calibrated=False)
    if not robot.forecasts:
        raise RecordingError(f"{options.robot}: no feature has a forecast; add 'forecast' to one")
    tables = _tables(robot, options.robot)
    found = [_calibrated(robot, each, options) for each in robot.forecasts]
    for table, features in tables.items():
        forecasts = [each.forecast for each in found if each.forecast.feature in features]
        with write_errors(table):
            replace_text(table, table_text(forecasts))
    for calibration in found:
        sys.stdout.write('\n'.join([*_lines(calibration), '']))
    short = [each.forecast.feature for each in found if each.is_short_of(options.coverage)]
    for name in short:
        sys.stderr.write(
            f"dyknow calibrate: the forecast of '{name}' covers less than {options.coverage:.4g} "
            'of the held-out truths; calibrate with more recordings that are like them\n'
        )
    return FALSE if short else SUCCESS


def _tables(robot: RobotConfiguration, path: Path) -> dict[Path, set[str]]:
    """Return the features whose calibration each table holds."""
    tables: dict[Path, set[str]] = {}
    for each in robot.forecasts:
        shown = f"{path}: the forecast of '{each.feature}'"
        if not each.sources:
            raise RecordingError(f'{shown} reads a stream; only those of topics can be calibrated')
        if each.table is None:
            raise RecordingError(f"{shown} names no table; add 'table: FILE' to it")
        tables.setdefault(each.table, set()).add(each.feature)
    return tables


def _calibrated(
    robot: RobotConfiguration, forecast: FeatureForecast, options: argparse.Namespace
) -> Calibration:
    types = message_types(options)
    block = options.block or forecast.horizons[-1]
    errors = list(forecast_errors(forecast, block, options.recording, types))
    others = list(forecast_errors(forecast, block, options.held_out, types))
    for each in (*errors, *others):
        for reason, count in each.refused.items():
            missing = f"{count} forecasts of '{forecast.feature}' are missing: {reason}"
            sys.stderr.write(f'dyknow calibrate: {each.recording}: {missing}\n')
    others = others if options.held_out else errors
    parities = (None, None) if options.held_out else (0, 1)
    if not all(any(len(each.times) for each in measured) for measured in (errors, others)):
        topics = ', '.join(topic for each in forecast.sources for topic in each.topics)
        raise RecordingError(f"the recordings have no message for '{forecast.feature}' ({topics})")
    scores = block_scores(errors, parities[0])
    try:
        widening = widening_of(scores, options.coverage)
        inside, whole = _coverage(others, parities[1], widening)
    except RecordingError as error:
        raise RecordingError(f"the forecast of '{forecast.feature}': {error.message}") from None
    promise = Coverage(options.coverage, len(scores), block)
    found = replace(forecast, widening=widening, coverage=str(promise))
    unit = robot.units.get(forecast.feature, '')
    return Calibration(
        found,
        sum(map(len, scores)),
        len(scores),
        len(block_scores(others, parities[1])),
        inside,
        whole,
        tuple(
            alarm_rates(condition, others, found, parities[1])
            for condition in conditions_of(robot.formulas, forecast, unit)
        ),
    )


def _coverage(
    errors: Iterable[ForecastErrors], parity: int | None, widening: Sequence[float]
) -> tuple[Floats, float]:
    """Return which part of the truths is inside, at each time, and at all times at once.

    Raises:
        RecordingError: without truths to test with.
    """
    found = [np.zeros((0, len(widening)))]
    for each in errors:
        # An interval does not become smaller than its value.
        limits = np.maximum(widening, -each.half_widths)
        inside = np.where(np.isnan(each.scores), np.nan, each.scores <= limits)
        found.append(inside[each.in_blocks(parity)])
    inside = np.concatenate(found)
    complete = inside[~np.isnan(inside).any(axis=1)]
    if not len(complete):
        raise RecordingError(
            'no held-out forecast has truths at all of its times to test with; give other '
            'recordings (--held-out), or other blocks (--block)'
        )
    return np.nanmean(inside, axis=0), float(complete.all(axis=1).mean())


def _lines(calibration: Calibration) -> Iterator[str]:
    forecast = calibration.forecast
    unit = f' {forecast.unit}' if forecast.unit else ''
    yield (
        f'{forecast.feature} by {forecast.by}: {calibration.samples} forecasts in '
        f'{calibration.blocks} blocks, tested with {calibration.held_out} blocks'
    )
    for horizon in forecast.horizons:
        step = horizon // forecast.step
        widening = forecast.widening[step]
        yield (
            f'  after {format_duration(horizon)}: widened by {widening:.4g}{unit}, '
            f'{calibration.inside[step]:.1%} of the held-out truths inside'
        )
    yield f'  all times at once: {calibration.whole:.1%} of the held-out forecasts'
    for each in calibration.alarms:
        missed, false = _rate(each.missed, each.events), _rate(each.false, each.calm)
        yield f'  {each.condition.text}: {missed} missed, {false} false alarms'
    yield f'  written to {forecast.table}'


def _rate(count: int, total: int) -> str:
    return f'{count} of {total}' + (f' ({count / total:.1%})' if total else '')


def _block(text: str) -> int:
    found = duration_option(text)
    if not found:
        raise argparse.ArgumentTypeError(f"'{text}' is no time above 0")
    return found


def _probability(text: str) -> float:
    try:
        found = float(text)
    except ValueError:
        found = math.nan
    if not 0 < found < 1:
        raise argparse.ArgumentTypeError(f"'{text}' is no number between 0 and 1")
    return found
