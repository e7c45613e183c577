"""The forecasts of the features of a robot.yaml, as streams and annotations.

    features:
      Altitude:
        of: {u: UAV}
        unit: m
        from: {topic: '/{u}/odom', field: pose.pose.position.z}
        forecast:
          by: constant_velocity
          fields: {rate: twist.twist.linear.z}
          horizons: 5 s
          step: 500 ms
          table: forecasts.yaml

For the object uav1, this makes the streams of `Altitude_low_5s[uav1]` and `Altitude_high_5s[uav1]`,
which `soon[5 s]` reads. The second one is

    stream forecast_Altitude_high_5s_uav1 = constant_velocity(
        select pose.pose.position.z as value, twist.twist.linear.z as rate from "/uav1/odom",
        horizon = 5 s, step = 500 ms, bound = "high", widening = "0.0 0.1 ...");

The widening is from the table, which `dyknow calibrate` writes. Without it, the name of the stream
ends with `NOT_CALIBRATED`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final

import yaml

from dyknow_common import (
    NOT_CALIBRATED,
    InlineText,
    LanguageError,
    Value,
    format_duration,
    quoted,
    value_text,
)
from dyknow_configuration.composed_text import (
    PLACEHOLDER,
    ComposedText,
    constraint_parts,
    variables,
)
from dyknow_configuration.regions import KNOWN_CONSTRAINTS
from dyknow_configuration.robot import (
    PATH_INPUTS,
    FeatureForecast,
    ForecastSource,
    RequestedFormula,
    RequestedGuard,
    RobotFeature,
    RobotVocabulary,
)
from dyknow_configuration.topics import FeatureCarrier
from dyknow_configuration.vocabulary import read_horizons
from dyknow_configuration.yaml_values import YamlValue, read_yaml
from dyknow_reasoning import Feature, ForecastBound, ForecastFeature, parse_formula, walk
from dyknow_stream_processing import (
    MAX_STEPS,
    Coverage,
    parse_specification,
    specifications_by_sink,
)

FORECAST_KEYS: Final = ('by', 'fields', 'path', 'horizons', 'step', 'settings', 'table')
PATH_KEYS: Final = ('topic', *KNOWN_CONSTRAINTS)
TABLE_KEYS: Final = ('forecast', 'coverage', 'widening')

_PLANNED: Final = 'planned_path'
_ODOMETRY: Final[Mapping[str, Mapping[str, str]]] = {
    'constant_turn_rate': {
        'speed': 'twist.twist.linear.x',
        'turn': 'twist.twist.angular.z',
        **{f'q{each}': f'pose.pose.orientation.{each}' for each in 'xyzw'},
    },
    _PLANNED: {
        **{each: f'pose.pose.position.{each}' for each in 'xy'},
        'speed': 'twist.twist.linear.x',
        'frame': 'header.frame_id',
    },
}
"""The fields that forecasts in the plane read beside `value` if none are given."""

_TEXTS: Final = frozenset({'frame', 'path_frame', 'path'})
"""The inputs that are texts; the others are numbers."""


@dataclass(slots=True)
class Forecasts:
    """The forecasts of a file.

    Args:
        features: the features with their forecasts.
        streams: their streams.
        annotations: what the streams mean.
    """

    features: list[FeatureForecast]
    streams: list[InlineText]
    annotations: list[InlineText]


def read_forecasts(
    values: Mapping[str, YamlValue], vocabulary: RobotVocabulary, *, calibrated: bool = True
) -> Forecasts:
    """Return the forecasts of the features of a robot.yaml.

    Args:
        values: the values of the file, by their keys.
        vocabulary: the vocabulary of the file.
        calibrated: False to leave the tables unread.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    found = Forecasts([], [], [])
    declarations: dict[str, str] = {}
    streams: list[str] = []
    entries = values['features'].entries('a mapping from features') if 'features' in values else []
    for name, value in entries:
        stated = {key.text(): each for key, each in value.entries('the description of a feature')}
        if 'forecast' not in stated:
            continue
        reader = _ForecastReader(vocabulary.features[name.text().strip()], stated, vocabulary)
        forecast = reader.read(calibrated=calibrated)
        declaration = reader.declaration(forecast)
        other = declarations.setdefault(forecast.by, declaration)
        if other != declaration:
            message = f"another forecast is declared by '{other}'; give it the same inputs"
            raise stated['forecast'].error(message)
        found.features.append(forecast)
        for text, meaning in reader.streams(forecast):
            streams.append(text)
            found.annotations.append(InlineText(stated['forecast'].place, meaning))
    if streams:
        units = (f'{each};\n' for each in declarations.values())
        found.streams.append(InlineText(found.annotations[0].name, ''.join([*units, *streams])))
    return found


class _ForecastReader:
    """Reads the forecast of one feature."""

    def __init__(
        self, feature: RobotFeature, stated: Mapping[str, YamlValue], vocabulary: RobotVocabulary
    ) -> None:
        self._feature = feature
        self._value = stated['forecast']
        self._stated = self._value.mapping(FORECAST_KEYS, ('by', 'horizons'))
        sources = stated['from'].one_or_more() if 'from' in stated else []
        if len(sources) != 1:
            raise self._value.error("a forecast needs one topic; give one in 'from'")
        self._carrier = FeatureCarrier(feature, sources[0], vocabulary)
        if 'where' in self._carrier.stated:
            raise self._value.error(
                'a forecast needs a topic of one object; one of many objects, with where, has none'
            )
        if 'expires' in self._carrier.stated:
            message = 'a forecast is made of known values; remove expires, or the forecast'
            raise self._carrier.stated['expires'].error(message)
        self._path: Mapping[str, YamlValue] = {}
        if 'path' in self._stated:
            self._path = self._stated['path'].mapping(PATH_KEYS, ('topic',))
            variables(self._path['topic'], tuple(feature.arguments))

    def read(self, *, calibrated: bool) -> FeatureForecast:
        """Return the forecast, with its widening if there is a table."""
        by = self._stated['by'].text('the name of a computational unit').strip()
        horizons = read_horizons(self._stated['horizons'])
        inputs = self._inputs(by)
        sources = (
            ForecastSource(
                self._carrier.stream_of(objects)[0],
                {name: _filled(path, objects) for name, path in inputs.items()},
                self._path_topic(objects),
            )
            for objects in self._carrier.choices()
        )
        forecast = FeatureForecast(
            self._feature.name,
            by,
            horizons,
            self._step(horizons),
            inputs,
            self._settings(by, inputs['value']),
            self._table(),
            self._carrier.unit or self._feature.unit,
            tuple(sources) if self._carrier.is_topic else (),
        )
        return self._with_table(forecast) if calibrated else forecast

    def streams(self, forecast: FeatureForecast) -> Iterator[tuple[str, str]]:
        """Yield the streams of a forecast, each with its annotation."""
        for objects in self._carrier.choices():
            for horizon in forecast.horizons:
                for bound in ForecastBound:
                    name = ForecastFeature(self._feature.name, bound, horizon).name
                    stream = '_'.join(('forecast', name, *objects.values()))
                    stream += '' if forecast.widening else NOT_CALIBRATED
                    call = self._call(forecast, horizon, bound, objects)
                    text = f'stream {stream} = {call};\nsink {stream};\n'
                    self._check(forecast, text)
                    arguments = ', '.join(objects[each] for each in self._feature.arguments)
                    feature = f'{name}[{arguments}]' if arguments else name
                    unit = f' [{self._carrier.unit}]' if self._carrier.unit else ''
                    yield text, f'stream {stream} contains {feature} = bound{unit};'

    def _call(
        self,
        forecast: FeatureForecast,
        horizon: int,
        bound: ForecastBound,
        objects: Mapping[str, str],
    ) -> str:
        fields = ', '.join(
            f'{_filled(path, objects)} as {name}' for name, path in forecast.inputs.items()
        )
        stream, constraints = self._carrier.stream_of(objects)
        source = quoted(stream) if self._carrier.is_topic else stream
        given = f' with {constraints}' if constraints else ''
        settings = {
            **{name: value_text(value) for name, value in forecast.settings.items()},
            'horizon': format_duration(horizon),
            'step': format_duration(forecast.step),
            'bound': quoted(bound),
        }
        if forecast.widening:
            numbers = forecast.widening[: horizon // forecast.step + 1]
            promise = f'; {forecast.coverage}' if forecast.coverage else ''
            settings['widening'] = quoted(' '.join(map(repr, numbers)) + promise)
        stated = ', '.join(f'{name} = {value}' for name, value in settings.items())
        path = ''
        if self._path:
            selected = ', '.join(f'{field} as {name}' for name, field in PATH_INPUTS.items())
            path = f', select {selected} from {quoted(self._path_topic(objects))}'
            parts = constraint_parts(self._path, self._path['topic'])
            path += ''.join(text for text, _ in parts)
        return f'{forecast.by}(select {fields} from {source}{given}{path}, {stated})'

    def _path_topic(self, objects: Mapping[str, str]) -> str:
        """Return the topic of the planned path; empty without one."""
        if not self._path:
            return ''
        return str(ComposedText().add_template(self._path['topic'], objects)).strip()

    def declaration(self, forecast: FeatureForecast) -> str:
        """Return the declaration of the unit of a forecast."""
        inputs = [forecast.inputs, PATH_INPUTS] if self._path else [forecast.inputs]
        typed = (
            ', '.join(f'{name}: {"string" if name in _TEXTS else "float"}' for name in fields)
            for fields in inputs
        )
        return f'compunit bound: float {forecast.by}({", ".join(f"({each})" for each in typed)})'

    def _check(self, forecast: FeatureForecast, text: str) -> None:
        try:
            declared = f'{self.declaration(forecast)}; {text}'
            specifications_by_sink(parse_specification(declared))
        except LanguageError as error:
            raise self._value.error(f'its stream is not well formed: {error.reason}') from None

    def _inputs(self, by: str) -> dict[str, str]:
        """Return the fields that a forecast reads, by the inputs of its unit."""
        known = tuple(self._feature.arguments)
        found = {'value': self._carrier.stated['field'].text().strip()}
        found |= _ODOMETRY.get(by, {})
        if 'fields' in self._stated:
            for key, value in self._stated['fields'].entries('a mapping from inputs to fields'):
                variables(value, known)
                if key.text().strip() == 'value':
                    raise key.error("'value' is the field of the feature; leave it out")
                found[key.text().strip()] = value.text('a field').strip()
        if by == _PLANNED and not self._path:
            raise self._stated['by'].error("add the path: 'path: {topic: TOPIC}'")
        if by == 'constant_velocity' and 'rate' not in found:
            raise self._value.error("add the field of the rate: 'fields: {rate: FIELD}'")
        return found

    def _step(self, horizons: tuple[int, ...]) -> int:
        """Return the step between the times of a forecast; by default, the first horizon / 10."""
        value = self._stated.get('step', self._stated['horizons'])
        step = value.duration() if 'step' in self._stated else horizons[0] // 10
        for each in horizons:
            if step <= 0 or each % step or each // step > MAX_STEPS:
                raise value.error(
                    f'{format_duration(each)} is not 1 to {MAX_STEPS} steps of '
                    f'{format_duration(step)}; write a step that divides all horizons'
                )
        return step

    def _settings(self, by: str, field: str) -> dict[str, Value]:
        found: dict[str, Value] = {}
        if by in _ODOMETRY and field[-1:] in {'x', 'y'}:
            found['axis'] = field[-1]
        if 'settings' in self._stated:
            for key, value in self._stated['settings'].entries('a mapping from names to values'):
                given = value.plain()
                if not isinstance(given, bool | int | float | str):
                    raise value.expected('a number or a text')
                found[key.text().strip()] = given
        return found

    def _table(self) -> Path | None:
        if 'table' not in self._stated:
            return None
        return self._stated['table'].file()

    def _with_table(self, forecast: FeatureForecast) -> FeatureForecast:
        if forecast.table is None or not forecast.table.exists():
            return forecast
        for name, value in read_yaml(forecast.table).entries('a mapping from features to tables'):
            if name.text() == forecast.feature:
                stated = value.mapping(TABLE_KEYS, TABLE_KEYS)
                widening, coverage = _read_widening(stated, forecast), stated['coverage']
                # A bare number is of a version that did not note the blocks.
                if _is_finite(coverage):
                    return replace(forecast, widening=widening)
                promise = str(coverage.read(Coverage.parse, coverage.line()))
                return replace(forecast, widening=widening, coverage=promise)
        return forecast


def _read_widening(stated: Mapping[str, YamlValue], forecast: FeatureForecast) -> tuple[float, ...]:
    measured = stated['forecast'].text('the forecast that was calibrated')
    if measured != forecast.description:
        raise stated['forecast'].error(
            f"the table is of another forecast than '{forecast.description}'; calibrate it again "
            'by dyknow calibrate'
        )
    numbers = stated['widening'].items('a list of numbers')
    if len(numbers) != forecast.steps + 1 or not all(map(_is_finite, numbers)):
        raise stated['widening'].error(
            f'the forecast has {forecast.steps + 1} times, and this is no list of as many finite '
            'numbers; calibrate it again by dyknow calibrate'
        )
    return tuple(each.number() for each in numbers)


def table_text(forecasts: Iterable[FeatureForecast]) -> str:
    """Return the table of forecasts with their widening, as `robot.yaml` names it."""
    document = {
        each.feature: {
            'forecast': each.description,
            'coverage': each.coverage,
            'widening': list(each.widening),
        }
        for each in forecasts
    }
    comment = '# Written by dyknow calibrate: by how much each time of a forecast is widened.\n'
    return comment + yaml.safe_dump(document, sort_keys=False, width=100)


def check_calibrated(
    values: Mapping[str, YamlValue],
    formulas: Iterable[RequestedFormula],
    guards: Iterable[RequestedGuard],
    forecasts: Iterable[FeatureForecast],
) -> None:
    """Check that no trigger and no guard depends on a forecast that is not calibrated.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    missing = {each.feature: each for each in forecasts if not each.widening}
    if not missing:
        return
    for formula in formulas:
        if formula.on and (name := _forecast_in(formula, missing)):
            raise _place(values['formulas'], formula.name, 'on').error(_reason(missing[name]))
    elements = values['guards'].items('a list of guards') if 'guards' in values else []
    for guard, element in zip(guards, elements, strict=True):
        named = dict(element.entries('a guard'))
        given = next(value for key, value in named.items() if key.text() == 'formulas')
        for formula, each in zip(guard.formulas, given.one_or_more(), strict=True):
            if name := _forecast_in(formula, missing):
                raise each.error(_reason(missing[name]))


def _forecast_in(formula: RequestedFormula, known: Mapping[str, object]) -> str:
    """Return a feature whose forecast a formula reads; empty if it reads none."""
    for each in walk(parse_formula(formula.text, formula.constants)):
        found = ForecastFeature.of(each.name) if isinstance(each, Feature) else None
        if found is not None and found.feature in known:
            return found.feature
    return ''


def _place(formulas: YamlValue, name: str, key: str) -> YamlValue:
    """Return the value of a key of a formula; of one in a file, the value that names the file."""
    for each in formulas.one_or_more():
        if each.is_mapping:
            stated = {key.word(): value for key, value in each.entries('a formula')}
            if stated['name'].line() == name:
                return stated[key]
    return formulas


def _reason(forecast: FeatureForecast) -> str:
    path = forecast.table
    mend = f'write {path.name} by dyknow calibrate' if path else "name a 'table' in its forecast"
    return (
        f"the forecast of '{forecast.feature}' is not calibrated, so nothing may be done because "
        f'of it; {mend}'
    )


def _is_finite(value: YamlValue) -> bool:
    return value.is_number and math.isfinite(value.number())


def _filled(path: str, objects: Mapping[str, str]) -> str:
    """Return the path of a field with objects in the place of `{variable}`."""
    return PLACEHOLDER.sub(lambda found: objects[found['name'].strip()], path)
