"""Reading of a robot.yaml: one file that describes a robot and what is monitored.

    objects: {Rover: [rover1]}
    features:
      Speed: {of: {r: Rover}, unit: m/s, from: {topic: '/{r}/odom', field: twist.twist.linear.x}}
    formulas:
      - {name: slow, formula: 'forall r in Rover: always Speed[r] < 1.5'}

All keys are optional. The ontology, the annotations and the streams of the robot are made from
the file; `ontology`, `annotations`, `streams` and `bridges` may also name files, in its folder or
relative to it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Final

from dyknow_common import InlineText
from dyknow_configuration.documents.yaml_values import YamlValue, read_yaml, texts
from dyknow_configuration.expectations import read_expectations
from dyknow_configuration.federation import read_federation
from dyknow_configuration.forecasts import check_calibrated, read_forecasts
from dyknow_configuration.formulas import formulas_of, read_constants
from dyknow_configuration.guards import read_guards
from dyknow_configuration.nodes import read_parameters
from dyknow_configuration.ontology_text import ontology_text
from dyknow_configuration.positions import read_positions
from dyknow_configuration.regions import read_regions
from dyknow_configuration.robot import RobotConfiguration, RobotMap, RobotVocabulary
from dyknow_configuration.stream_texts import is_stream_text, read_streams
from dyknow_configuration.topics import MAX_TEXTS, read_topics
from dyknow_configuration.triggers.reading import NO_TRIGGERS, read_triggers
from dyknow_configuration.vocabulary import FEATURE_KEYS, read_uncertainty, read_vocabulary
from dyknow_reasoning import NO_CONSTANTS

KEYS: Final = (
    'sorts',
    'objects',
    'features',
    'streams',
    'regions',
    'positions',
    'topics',
    'constants',
    'triggers',
    'formulas',
    'guards',
    'federation',
    'nodes',
    'ontology',
    'annotations',
    'bridges',
    'domains',
)
"""The keys of a robot.yaml."""

_STREAM_HINT: Final = '; a text begins with source, compunit, stream or sink'


def read_robot(
    path: Path, objects: Mapping[str, Sequence[str]] | None = None, *, calibrated: bool = True
) -> RobotConfiguration:
    """Return what a robot.yaml describes.

    Args:
        path: the file.
        objects: of sorts, in the place of those that the file lists.
        calibrated: False to leave the tables of forecasts unread, and triggers and guards
            unchecked that need them: they are about to be written.

    Raises:
        ConfigurationError: naming the file, the place and the correction.
    """
    return robot_of(read_yaml(path), objects, calibrated=calibrated)


def robot_of(
    document: YamlValue,
    objects: Mapping[str, Sequence[str]] | None = None,
    *,
    calibrated: bool = True,
) -> RobotConfiguration:
    """Return what the whole of a robot.yaml describes; as `read_robot`."""
    values, path = document.mapping(KEYS), document.document.path
    regions = read_regions(values['regions']) if 'regions' in values else ()
    vocabulary = read_vocabulary(values, regions).with_objects(objects or {})
    positions = read_positions(values, vocabulary, regions)
    constants = read_constants(values['constants']) if 'constants' in values else NO_CONSTANTS
    triggers = read_triggers(values['triggers']) if 'triggers' in values else NO_TRIGGERS
    formulas = formulas_of(
        [values['formulas']] if 'formulas' in values else [], constants, triggers
    )
    guards = read_guards(values['guards'], formulas, constants) if 'guards' in values else ()
    forecasts = read_forecasts(values, vocabulary, calibrated=calibrated)
    if calibrated:
        check_calibrated(values, formulas, guards, forecasts.features)
    return RobotConfiguration(
        ontologies=(*_files(texts(values, 'ontology')), *_ontology(vocabulary, path)),
        annotations=(
            *_files(texts(values, 'annotations')),
            *_annotations(values, vocabulary),
            *positions.annotations,
            *forecasts.annotations,
        ),
        streams=(*_streams(values, vocabulary), *positions.streams, *forecasts.streams),
        bridges=tuple(_files(texts(values, 'bridges'))),
        domains=_domains(values),
        formulas=formulas,
        parameters=read_parameters(values['nodes']) if 'nodes' in values else {},
        guards=guards,
        units={name: each.unit for name, each in vocabulary.features.items() if each.unit},
        topics=read_expectations(values['topics']) if 'topics' in values else (),
        federation=read_federation(values['federation']) if 'federation' in values else None,
        forecasts=tuple(forecasts.features),
        map=RobotMap(tuple(each.region for each in regions), positions.topics),
    )


def _streams(
    values: Mapping[str, YamlValue], vocabulary: RobotVocabulary
) -> list[Path | InlineText]:
    stated = values['streams'].one_or_more() if 'streams' in values else []
    own = [each for each in stated if is_stream_text(each)]
    named = [each for each in stated if each not in own]
    return [*_files(named, _STREAM_HINT), *read_streams(own, vocabulary)]


def _ontology(vocabulary: RobotVocabulary, path: Path) -> list[InlineText]:
    if not vocabulary:
        return []
    name = re.sub(r'[^A-Za-z0-9_]+', '_', path.stem)
    return [InlineText(str(path), ontology_text(vocabulary, name))]


def _annotations(values: Mapping[str, YamlValue], vocabulary: RobotVocabulary) -> list[InlineText]:
    if 'features' not in values:
        return []
    found: list[InlineText] = []
    for name, value in values['features'].entries('a mapping from features'):
        feature = vocabulary.features[name.text().strip()]
        stated = value.mapping(FEATURE_KEYS)
        if 'from' in stated:
            unless = stated.get('unknown')
            found += read_topics(feature, stated['from'], vocabulary, unless=unless)
        if 'from' in stated and 'uncertainty' in stated:
            uncertainty = read_uncertainty(feature, stated['uncertainty'])
            if uncertainty.measured is not None:
                measured, field = uncertainty.measured, uncertainty.field
                found += read_topics(measured, stated['from'], vocabulary, field)
        if len(found) > MAX_TEXTS:
            raise name.error(f'the file makes more than {MAX_TEXTS} annotations; split it')
    return found


def _domains(values: Mapping[str, YamlValue]) -> dict[str, tuple[str, ...]]:
    if 'domains' not in values:
        return {}
    entries = values['domains'].entries('a mapping from sorts to lists of objects')
    return {
        sort.text(): tuple(each.text('an object') for each in objects.one_or_more())
        for sort, objects in entries
    }


def _files(values: list[YamlValue], hint: str = '') -> list[Path]:
    """Return the files that texts name, which must exist."""
    paths: list[Path] = []
    for each in values:
        path = each.document.path.parent / each.text('the name of a file').strip()
        if not path.is_file():
            raise each.error(f'there is no file {path}{hint}')
        paths.append(path)
    return paths
