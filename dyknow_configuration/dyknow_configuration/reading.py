"""Reading of a robot.yaml: one file that describes a robot and what is monitored.

    objects: {Rover: [rover1]}
    features:
      Speed: {of: {r: Rover}, unit: m/s, from: {topic: '/{r}/odom', field: twist.twist.linear.x}}
    formulas:
      - {name: slow, formula: 'forall r in Rover: always Speed[r] < 1.5'}

All keys are optional. The ontology, the annotations and the streams of the robot are made from
the file; `ontology`, `annotations`, `streams` and `bridges` may also name files, in its folder or
relative to it.

`streams` may also be texts in the stream language, for each object of a sort if wanted:

    streams:
      - compunit power: float electrical_power((voltage: float, current: float));
      - for: {r: Rover}
        text: |
          stream {r}_power = electrical_power("/{r}/battery");
          sink {r}_power;
"""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Iterable, Iterator, Mapping, Sequence
from html import escape
from math import prod
from pathlib import Path
from types import MappingProxyType
from typing import Final

from dyknow_common import MAX_CHARACTERS, InlineText, unknown
from dyknow_configuration.composed_text import ComposedText
from dyknow_configuration.expectations import read_expectations
from dyknow_configuration.federation import read_federation
from dyknow_configuration.forecasts import check_calibrated, read_forecasts
from dyknow_configuration.formulas import formulas_of, read_constants
from dyknow_configuration.guards import read_guards
from dyknow_configuration.nodes import read_parameters
from dyknow_configuration.positions import read_positions
from dyknow_configuration.regions import (
    StatedRegion,
    read_regions,
    read_relations,
)
from dyknow_configuration.robot import (
    RobotConfiguration,
    RobotFeature,
    RobotSort,
    RobotVocabulary,
    TextSource,
    choices,
)
from dyknow_configuration.topics import MAX_TEXTS, read_topics
from dyknow_configuration.triggers import NO_TRIGGERS, read_triggers
from dyknow_configuration.vocabulary import FEATURE_KEYS, read_uncertainty, read_vocabulary
from dyknow_configuration.yaml_values import YamlValue, read_yaml, texts
from dyknow_reasoning import NO_CONSTANTS
from dyknow_space import SpatialStatement
from dyknow_stream_processing import parse_specification, specifications_by_sink

KEYS: Final = (
    'sorts',
    'objects',
    'features',
    'streams',
    'regions',
    'relations',
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

TEMPLATE_KEYS: Final = ('for', 'text')

_DECLARATION: Final = re.compile(r'\s*(#|(source|compunit|stream|sink)\s)')


def read_robot(
    path: Path, objects: Mapping[str, Sequence[str]] | None = None, *, calibrated: bool = True
) -> RobotConfiguration:
    """Return what a robot.yaml describes.

    Args:
        path: the file.
        objects: the objects of sorts; they replace the objects that the file lists.
        calibrated: False to leave the tables of forecasts unread, as they are about to be written;
            triggers and guards that need them are not checked.

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
    stated = [values['formulas']] if 'formulas' in values else []
    formulas = formulas_of(stated, constants, triggers)
    guards = read_guards(values['guards'], formulas, constants) if 'guards' in values else ()
    forecasts = read_forecasts(values, vocabulary, calibrated=calibrated)
    if calibrated:
        check_calibrated(values, formulas, guards, forecasts.features)
    return RobotConfiguration(
        ontologies=_ontologies(values, vocabulary, regions, path),
        annotations=(
            *(each.existing_file() for each in texts(values, 'annotations')),
            *_annotations(values, vocabulary),
            *positions.annotations,
            *forecasts.annotations,
        ),
        streams=(*_streams(values, vocabulary), *positions.streams, *forecasts.streams),
        bridges=tuple(each.existing_file() for each in texts(values, 'bridges')),
        domains=_domains(values),
        formulas=formulas,
        parameters=read_parameters(values['nodes']) if 'nodes' in values else {},
        guards=guards,
        units={name: each.unit for name, each in vocabulary.features.items() if each.unit},
        topics=read_expectations(values['topics']) if 'topics' in values else (),
        federation=read_federation(values['federation']) if 'federation' in values else None,
        forecasts=tuple(forecasts.features),
        map=positions.map,
        triggers=tuple(triggers.values()),
    )


def _streams(
    values: Mapping[str, YamlValue], vocabulary: RobotVocabulary
) -> list[Path | InlineText]:
    stated = values['streams'].one_or_more() if 'streams' in values else []
    own = [
        each
        for each in stated
        if each.is_mapping or _DECLARATION.match(each.text('streams or a file'))
    ]
    named = [each for each in stated if each not in own]
    return [
        *(each.existing_file(_STREAM_HINT) for each in named),
        *read_streams(own, vocabulary),
    ]


def _ontologies(
    values: Mapping[str, YamlValue],
    vocabulary: RobotVocabulary,
    regions: Sequence[StatedRegion],
    path: Path,
) -> tuple[TextSource, ...]:
    files = [each.existing_file() for each in texts(values, 'ontology')]
    objects = {name for sort in vocabulary.sorts.values() for name in sort.objects}
    relations = read_relations(values, regions, objects)
    if not vocabulary:
        return tuple(files)
    name = re.sub(r'[^A-Za-z0-9_]+', '_', path.stem)
    return (*files, InlineText(str(path), ontology_text(vocabulary, name, relations)))


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
            uncertainty.check_others(feature, vocabulary.features)
            for measured, field in uncertainty.measured:
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


_HEADER = """\
<?xml version="1.0" encoding="UTF-8"?>
<rdf:RDF xmlns="{iri}#"
         xml:base="{iri}"
         xmlns:dyknow="http://www.dyknow.org/ontology#"
         xmlns:owl="http://www.w3.org/2002/07/owl#"
         xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"
         xmlns:rdfs="http://www.w3.org/2000/01/rdf-schema#">

    <owl:Ontology rdf:about="{iri}">
        <owl:imports rdf:resource="http://www.dyknow.org/ontology"/>
    </owl:Ontology>
"""


def ontology_text(
    vocabulary: RobotVocabulary,
    name: str,
    relations: Mapping[str, Sequence[SpatialStatement]] = MappingProxyType({}),
) -> str:
    """Return the ontology of a vocabulary.

    Args:
        vocabulary: the sorts, objects and features.
        name: the name of the ontology, which becomes the prefix of its names.
        relations: what is known of the relations of regions, by region.
    """
    lines = [_HEADER.format(iri=f'http://www.dyknow.org/robots/{name}')]
    for sort in vocabulary.sorts.values():
        lines += _class(sort, 'Object', ())
    for feature in vocabulary.features.values():
        above = 'Feature' if feature.arguments else 'NullaryFeature'
        lines += _class(feature, above, _signature(feature))
    sorts: defaultdict[str, list[str]] = defaultdict(list)
    for sort in vocabulary.sorts.values():
        for object_ in sort.objects:
            sorts[object_].append(sort.name)
    for object_, names in sorted(sorts.items()):
        lines.append(f'    <owl:NamedIndividual rdf:about="#{object_}">')
        lines += [f'        <rdf:type rdf:resource="#{each}"/>' for each in names]
        if object_ in relations:
            known = '; '.join(map(str, relations[object_]))
            lines.append(f'        <dyknow:relations>{known}</dyknow:relations>')
        lines.append('    </owl:NamedIndividual>')
    return '\n'.join([*lines, '</rdf:RDF>', ''])


def _class(
    concept: RobotSort | RobotFeature, above: str, details: tuple[str, ...]
) -> Iterator[str]:
    parent = f'#{concept.below}' if concept.below else f'http://www.dyknow.org/ontology#{above}'
    yield f'    <owl:Class rdf:about="#{concept.name}">'
    yield f'        <rdfs:subClassOf rdf:resource="{parent}"/>'
    if concept.description:
        yield f'        <rdfs:comment>{escape(concept.description, quote=False)}</rdfs:comment>'
    yield from (f'        {each}' for each in details)
    yield '    </owl:Class>'


def _signature(feature: RobotFeature) -> tuple[str, ...]:
    unit = escape(feature.unit, quote=False)
    bounds = ' '.join(map(str, feature.unknown or ()))
    uncertainty = feature.uncertainty
    return (
        *(
            f'<dyknow:argument{number} rdf:resource="#{sort}"/>'
            for number, sort in enumerate(feature.arguments.values(), start=1)
        ),
        f'<dyknow:value_type>{feature.value_type}</dyknow:value_type>',
        *([f'<dyknow:unit>{unit}</dyknow:unit>'] if unit else []),
        *([f'<dyknow:unknown>{bounds}</dyknow:unknown>'] if bounds else []),
        *([f'<dyknow:uncertainty>{uncertainty}</dyknow:uncertainty>'] if uncertainty else []),
    )


def read_streams(
    values: Iterable[YamlValue], vocabulary: RobotVocabulary
) -> tuple[InlineText, ...]:
    """Return the text of all streams, empty if there are none.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    text = ComposedText()
    place = ''
    for value in values:
        place = place or value.place
        _add(text, value, vocabulary)
    if not text:
        return ()
    with text.errors():
        specifications_by_sink(parse_specification(str(text)))
    return (InlineText(place, str(text)),)


def _add(text: ComposedText, value: YamlValue, vocabulary: RobotVocabulary) -> None:
    if not value.is_mapping:
        text.add_value(value).add(_separator(value), value)
        return
    stated = value.mapping(TEMPLATE_KEYS, TEMPLATE_KEYS)
    sorts: dict[str, str] = {}
    for variable, sort in stated['for'].entries('a mapping from variables to sorts'):
        name = sort.text('the name of a sort').strip()
        if name not in vocabulary.sorts:
            raise sort.error(unknown('sort', name, vocabulary.sorts))
        sorts[variable.text().strip()] = name
    domains = {variable: vocabulary.objects(sort) for variable, sort in sorts.items()}
    if prod(map(len, domains.values())) > MAX_TEXTS:
        raise value.error(f'this makes more than {MAX_TEXTS} copies; split it')
    for objects in choices(domains):
        text.add_template(stated['text'], objects)
        text.add(_separator(stated['text']), stated['text'])
        if len(text) > MAX_CHARACTERS:
            raise value.error(f'the streams have more than {MAX_CHARACTERS} characters; split them')


def _separator(value: YamlValue) -> str:
    """Return what separates a text from the next one."""
    lines = [line.partition('#')[0] for line in value.text().splitlines()]
    # Its last line may end in a comment.
    return '\n' if ''.join(lines).rstrip().endswith(';') else '\n;\n'
