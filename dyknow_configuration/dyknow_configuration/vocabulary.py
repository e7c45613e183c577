"""The sorts, objects and features of a robot.yaml."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import isfinite
from typing import Final

from dyknow_common import (
    FORMULA_WORDS,
    FUNCTIONS,
    SSL_WORDS,
    ValueType,
    check_unit,
    format_duration,
    unit_conversion,
    unknown,
)
from dyknow_configuration.regions import (
    DISTANCES,
    POSES,
    SIGHT,
    StatedRegion,
    positioned_sorts,
    states_any,
)
from dyknow_configuration.robot import RobotFeature, RobotSort, RobotVocabulary
from dyknow_configuration.yaml_values import YamlValue, texts
from dyknow_reasoning import ANY_NUMBER, SPATIAL, ForecastBound, ForecastFeature
from dyknow_space import RELATION_NAMES

SORT_KEYS: Final = ('below', 'description')
FEATURE_KEYS: Final = (
    'of',
    'type',
    'unit',
    'uncertainty',
    'below',
    'description',
    'missing',
    'unknown',
    'range',
    'from',
    'forecast',
)
_AMOUNTS: Final = ('variance', 'deviation', 'interval', 'samples')
_FUNCTIONS: Final = {'interval': 'within', 'samples': 'sampled'}
UNCERTAINTY_KEYS: Final = (*_AMOUNTS, 'time_constant', 'covariances')

MAX_OBJECTS: Final = 10_000
"""The number of objects of a file, as many as a formula may have by default (`object_limit`)."""

MAX_HORIZONS: Final = 10
"""The number of horizons of a forecast; each makes two features."""

_EXTREMES: Final = {ForecastBound.LOW: 'least', ForecastBound.HIGH: 'greatest'}
_ARTICLES: Final = {'sort': 'a', 'feature': 'a', 'object': 'an'}
_NAME: Final = re.compile(r'[A-Za-z_][A-Za-z0-9_]*')
_RESERVED: Final = FORMULA_WORDS | SSL_WORDS | FUNCTIONS | SPATIAL.keys()
_UPPER: Final = {'Object', 'Feature', 'NullaryFeature', 'Thing', 'Nothing'}


def is_free_name(name: str) -> bool:
    """Return True if a text can be the name of a sort, an object or a feature."""
    return bool(_NAME.fullmatch(name)) and name not in _RESERVED and name not in _UPPER


def read_horizons(value: YamlValue) -> tuple[int, ...]:
    """Return the horizons of a forecast in nanoseconds, in ascending order.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    found = [each.duration() for each in value.one_or_more()]
    if not 0 < len(found) <= MAX_HORIZONS:
        raise value.error(f'a forecast has 1 to {MAX_HORIZONS} horizons, such as [1 s, 5 s]')
    for each, horizon in zip(value.one_or_more(), found, strict=True):
        if horizon <= 0:
            raise each.error('a horizon must be longer than 0')
    return tuple(sorted({*found}))


def read_vocabulary(
    values: Mapping[str, YamlValue], regions: Sequence[StatedRegion] = ()
) -> RobotVocabulary:
    """Return the sorts and features of a robot.yaml.

    Args:
        values: the values by key.
        regions: the regions; they are objects of their sorts, and of Region.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    return _VocabularyReader(values, regions).read()


class _VocabularyReader:
    """Reads sorts first, as features refer to them."""

    def __init__(self, values: Mapping[str, YamlValue], regions: Sequence[StatedRegion]) -> None:
        self._values = values
        self._regions = regions
        self._has_regions = bool(regions) or 'relations' in values
        self._kinds: dict[str, str] = {}
        self._sorts: dict[str, RobotSort] = {}
        self._features: dict[str, RobotFeature] = {}

    def read(self) -> RobotVocabulary:
        """Return the vocabulary."""
        self._read_sorts()
        self._read_objects()
        self._read_regions()
        if 'features' in self._values:
            for name, value in self._values['features'].entries('a mapping from features'):
                self._read_feature(name, value)
        return RobotVocabulary(self._sorts.values(), self._features.values())

    def _read_sorts(self) -> None:
        if 'sorts' not in self._values:
            return
        for key, value in self._values['sorts'].entries('a mapping from sorts'):
            stated = value.mapping(SORT_KEYS)
            name = self._name(key, 'sort')
            self._sorts[name] = RobotSort(
                name,
                self._below(stated, self._sorts, 'sort'),
                stated['description'].line() if 'description' in stated else '',
            )

    def _read_objects(self) -> None:
        if 'objects' not in self._values:
            return
        listed = self._values['objects'].entries('a mapping from sorts to lists of objects')
        count = 0
        for name, value in listed:
            sort = self._sort(name) if 'sorts' in self._values else self._name(name, 'sort')
            objects = value.items('a list of objects')
            names: dict[str, None] = {}
            count += len(objects)
            if count > MAX_OBJECTS:
                raise value.error(f'the file lists more than {MAX_OBJECTS} objects; list fewer')
            for each in objects:
                object_ = self._name(each, 'object')
                if object_ in names:
                    raise each.error(f"'{object_}' is given twice; keep one")
                names[object_] = None
            known = self._sorts.get(sort, RobotSort(sort))
            self._sorts[sort] = replace(known, objects=tuple(names))

    def _read_regions(self) -> None:
        """Add regions to the objects, and their distances to the features."""
        sorts: dict[str, YamlValue] = {}
        for each in self._regions:
            self._checked_name(each.region.name, each.key, 'object')
            for sort in each.region.sorts:
                self._add_object(each.region.name, sort, each.sorts or each.key)
            found = [
                sort for sort, known in self._sorts.items() if each.region.name in known.objects
            ]
            if not found:
                raise each.key.error(f"say what '{each.region.name}' is, such as 'is: NoFly'")
            sorts |= dict.fromkeys(found, each.key)
        if 'positions' in self._values:
            self._read_positions(self._values['positions'], sorts)

    def _read_positions(self, value: YamlValue, regions: Mapping[str, YamlValue]) -> None:
        """Add the distances to sorts of regions, the poses and the sight to the features."""
        positioned = {self._sort(each): each for each in positioned_sorts(value)}
        units: dict[str, str] = dict.fromkeys(DISTANCES.values(), 'm') if regions else {}
        if states_any(value, ('orientation', 'yaw')):
            units |= {name: unit for name, (_, unit) in POSES.items()}
        if states_any(value, ('walls',)):
            units[SIGHT] = 'm'
        if not units:
            return
        arguments = {'object': self._join('Positioned', positioned)}
        region = {'region': self._join('Region', regions)} if regions else {}
        for name, unit in units.items():
            self._checked_name(name, value, 'feature')
            other = {'other': arguments['object']} if name == SIGHT else region
            of = arguments if name in POSES else arguments | other
            self._features[name] = RobotFeature(name, of, unit=unit)

    def _add_object(self, name: str, sort: str, origin: YamlValue) -> None:
        if 'sorts' in self._values and sort not in self._sorts:
            raise origin.error(unknown('sort', sort, self._sorts))
        known = self._sorts.get(sort, RobotSort(self._checked_name(sort, origin, 'sort')))
        objects = tuple(dict.fromkeys((*known.objects, name)))
        self._sorts[sort] = replace(known, objects=objects)

    def _join(self, name: str, sorts: Mapping[str, YamlValue]) -> str:
        """Return a sort that contains some sorts; one is made if they are several."""
        if len(sorts) == 1:
            return next(iter(sorts))
        self._sorts = {name: self._sorts.pop(name, RobotSort(name)), **self._sorts}
        for sort, origin in sorts.items():
            top = sort
            while self._sorts[top].below:
                top = self._sorts[top].below
            if top in {'Positioned', 'Region'} - {name}:
                raise origin.error(f"'{sort}' has positions and is a region; separate the two")
            if top != name:
                self._sorts[top] = replace(self._sorts[top], below=name)
        return name

    def _read_feature(self, key: YamlValue, value: YamlValue) -> None:
        stated = value.mapping(FEATURE_KEYS)
        below = self._below(stated, self._features, 'feature')
        above = self._features.get(below, RobotFeature(''))
        arguments = self._arguments(stated['of']) if 'of' in stated else above.arguments
        if below and len(arguments) != len(above.arguments):
            raise stated['of'].error(
                f"'{below}' has {len(above.arguments)} arguments; give as many"
            )
        value_type, unit = above.value_type, above.unit
        if 'type' in stated:
            value_type = ValueType(stated['type'].choice('type', [*ValueType]))
        if 'unit' in stated:
            unit = stated['unit'].text().strip()
            stated['unit'].read(check_unit, unit)
            if value_type in {ValueType.STRING, ValueType.BOOLEAN}:
                raise stated['unit'].error(f'values of type {value_type} have no unit; remove it')
        if below:
            _check_below(stated, above, value_type, unit)
        name = self._name(key, 'feature')
        if ForecastFeature.of(name):
            raise key.error(f"'{name}' is the name of a bound of a forecast; choose another name")
        description = stated['description'].line() if 'description' in stated else ''
        found = RobotFeature(
            name, arguments, below, value_type, unit, description, _unknown(stated, value_type)
        )
        self._features[name] = found
        if self._features.get(below, found).uncertainty:
            message = 'a feature with an uncertainty has one topic, so none is below it'
            raise stated['below'].error(message)
        if 'uncertainty' in stated:
            self._add_uncertainty(found, stated['uncertainty'])
        if 'forecast' in stated:
            self._read_forecast(stated['forecast'], self._features[name])

    def _add_uncertainty(self, feature: RobotFeature, value: YamlValue) -> None:
        """Add the uncertainty of a feature, and the features that measure it."""
        if feature.value_type in {ValueType.STRING, ValueType.BOOLEAN}:
            raise value.error(f'values of type {feature.value_type} have no uncertainty; remove it')
        uncertainty = read_uncertainty(feature, value)
        self._features[feature.name] = replace(feature, uncertainty=uncertainty.text)
        for measured, _ in uncertainty.measured:
            if measured.name in self._kinds:
                raise value.error(
                    f"the feature '{measured.name}' is made of this; rename the other"
                )
            self._kinds[measured.name] = 'feature'
            self._features[measured.name] = measured

    def _read_forecast(self, value: YamlValue, feature: RobotFeature) -> None:
        """Add the features that hold the bounds of a forecast."""
        if feature.value_type not in {ValueType.FLOAT, ValueType.INT}:
            raise value.error(f'values of type {feature.value_type} have no forecast; remove it')
        stated = dict(value.entries('a mapping with by and horizons'))
        is_unknown = RobotVocabulary((), self._features.values()).may_be_unknown(feature)
        horizons = next((each for key, each in stated.items() if key.text() == 'horizons'), None)
        for horizon in read_horizons(horizons) if horizons else ():
            for bound in ForecastBound:
                found = ForecastFeature(feature.name, bound, horizon)
                self._features[found.name] = replace(
                    feature,
                    name=found.name,
                    below='',
                    value_type=ValueType.FLOAT,
                    unknown=ANY_NUMBER if is_unknown else None,
                    uncertainty='',
                    description=f'The {_EXTREMES[bound]} {feature.name} that its forecast allows '
                    f'within {format_duration(horizon)}.',
                )

    def _arguments(self, value: YamlValue) -> dict[str, str]:
        if not value.is_mapping:
            sorts = [self._sort(each) for each in texts({'of': value}, 'of')]
            for index, each in enumerate(sorts):
                if each in sorts[:index]:
                    raise value.error(
                        f'name the arguments of one sort, such as {{a: {each}, b: {each}}}'
                    )
            return {each: each for each in sorts}
        found: dict[str, str] = {}
        for variable, sort in value.entries('a mapping from variables to sorts'):
            if not _NAME.fullmatch(variable.text()):
                raise variable.error('a variable has letters, digits and _ only; rename it')
            found[variable.text()] = self._sort(sort)
        return found

    def _sort(self, value: YamlValue) -> str:
        """Return the name of a sort that is declared."""
        name = value.text('the name of a sort').strip()
        if name not in self._sorts:
            raise value.error(unknown('sort', name, self._sorts))
        return name

    def _below(
        self, stated: Mapping[str, YamlValue], known: Mapping[str, object], kind: str
    ) -> str:
        if 'below' not in stated:
            return ''
        name = stated['below'].text(f'the name of a {kind}').strip()
        if name not in known:
            hint = f'; declare a {kind} before those below it'
            raise stated['below'].error(unknown(kind, name, known) + hint)
        return name

    def _name(self, value: YamlValue, kind: str) -> str:
        """Return a name that is of no other kind."""
        name = value.text(f'the name of {_ARTICLES[kind]} {kind}').strip()
        return self._checked_name(name, value, kind)

    def _checked_name(self, name: str, value: YamlValue, kind: str) -> str:
        if not _NAME.fullmatch(name):
            raise value.error(
                f"'{name}' is no name of {_ARTICLES[kind]} {kind}; use letters, digits and _, and "
                'begin with no digit'
            )
        if name in _RESERVED or name in _UPPER:
            raise value.error(f"'{name}' is a reserved word; choose another name")
        if kind == 'feature' and name in RELATION_NAMES and self._has_regions:
            raise value.error(f"'{name}' is a relation of regions; choose another name")
        other = self._kinds.setdefault(name, kind)
        if other != kind:
            raise value.error(f"'{name}' is the name of a {other} already; choose another name")
        return name


def _unknown(stated: Mapping[str, YamlValue], value_type: ValueType) -> tuple[float, float] | None:
    """Return the bounds of a feature that may be unknown; None for one that may not."""
    if 'unknown' in stated and 'forecast' in stated:
        message = 'a forecast is made of all messages; remove unknown, or the forecast'
        raise stated['unknown'].error(message)
    is_unknown = 'unknown' in stated
    if 'missing' in stated:
        is_unknown |= stated['missing'].choice('answer', ['error', 'unknown']) == 'unknown'
    bounds = ANY_NUMBER
    if 'range' in stated:
        value = stated['range']
        if value_type in {ValueType.STRING, ValueType.BOOLEAN}:
            raise value.error(f'values of type {value_type} have no range; remove it')
        if not is_unknown:
            raise value.error(
                "only 'missing: unknown' needs a range: the values that are possible; add it, or "
                'remove the range'
            )
        found = [each.number() for each in value.items('a list of two numbers')]
        if len(found) != len(bounds) or not found[0] <= found[1]:
            raise value.error('give the least and the greatest value, such as [0, 1]')
        bounds = found[0], found[1]
    return bounds if is_unknown else None


@dataclass(frozen=True, slots=True)
class FeatureUncertainty:
    """The uncertainty of a feature.

    Args:
        text: what is known of its values, `normal(Height, sqrt(Height_variance), 2 s)`.
        measured: the features that messages hold, `Height_variance`, with their fields.
        others: the features that covariances are given with.
    """

    text: str
    measured: Sequence[tuple[RobotFeature, YamlValue]]
    others: Sequence[YamlValue]

    def check_others(self, feature: RobotFeature, features: Mapping[str, RobotFeature]) -> None:
        """Check that covariances of a feature are given with others that have normal errors."""
        sorts = list(feature.arguments.values())
        for each in self.others:
            other = features.get(each.word(), feature)
            is_alike = other is not feature and list(other.arguments.values()) == sorts
            if not (is_alike and other.uncertainty.startswith('normal')):
                raise each.error(
                    f"'{each.word()}' is no other feature of the same sorts with a variance or a "
                    'deviation, as a covariance needs; give it one, or remove the covariance'
                )


def read_uncertainty(feature: RobotFeature, value: YamlValue) -> FeatureUncertainty:
    """Return the uncertainty of a feature.

    Args:
        feature: the feature.
        value: the value of its key `uncertainty`.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    stated = value.mapping((*UNCERTAINTY_KEYS, 'weights'))
    if 'weights' in stated:
        raise stated['weights'].error(
            'no interval is certain for samples with weights, as the heaviest may be missing among '
            'them; remove it, and require equal weights, as after the filter has resampled, in '
            'the formula'
        )
    kinds = [each for each in _AMOUNTS if each in stated]
    if len(kinds) != 1:
        raise value.error(f'give one of {", ".join(_AMOUNTS)}, a field or a number')
    (kind,) = kinds
    measured: list[tuple[RobotFeature, YamlValue]] = []
    amount = _amount(feature, kind, '', stated[kind], measured)
    terms = [feature.name, f'sqrt({amount})' if kind == 'variance' else amount]
    for key in ('time_constant', 'covariances'):
        if kind in {'interval', 'samples'} and key in stated:
            raise stated[key].error(f'only normal errors have {key}; remove it')
    if 'time_constant' in stated:
        terms.append(format_duration(stated['time_constant'].non_negative_duration()))
    others = []
    if 'covariances' in stated:
        for other, given in stated['covariances'].entries('a mapping from features'):
            amount = _amount(feature, 'covariance', other.word(), given, measured)
            terms.append(f'covariance({other.word()}, {amount})')
            others.append(other)
    text = f'{_FUNCTIONS.get(kind, "normal")}({", ".join(terms)})'
    return FeatureUncertainty(text, measured, others)


def _amount(
    feature: RobotFeature,
    kind: str,
    other: str,
    value: YamlValue,
    measured: list[tuple[RobotFeature, YamlValue]],
) -> str:
    """Return the text of a number, or of the feature that measures it, which is added."""
    if value.is_number:
        number = value.plain()
        if kind == 'samples':
            raise value.error('samples are the numbers in an array; name the field, poses.x')
        if not isfinite(number) or (number < 0 and not other):
            raise value.error(f'a {kind} is finite{"" if other else ", and not negative"}')
        return repr(number)
    name = '_'.join(filter(None, (feature.name, other, kind)))
    whose = f'{feature.name} and {other}' if other else feature.name
    value_type = ValueType.STRING if kind == 'samples' else ValueType.FLOAT
    description = f'The {kind} of {whose}.'
    found = RobotFeature(name, feature.arguments, '', value_type, description=description)
    measured.append((found, value))
    return name


def _check_below(
    stated: Mapping[str, YamlValue], above: RobotFeature, value_type: ValueType, unit: str
) -> None:
    """Check that a stream of a feature can replace one of the feature above it."""
    if not above.value_type.accepts(value_type):
        raise stated['type'].error(f"values of '{above.name}' are of type {above.value_type}")
    if unit != above.unit and not above.unit:
        raise stated['unit'].error(f"'{above.name}' has no unit; remove it, or give one there")
    if unit != above.unit:
        stated['unit'].read(lambda text: unit_conversion(text, above.unit), unit)
