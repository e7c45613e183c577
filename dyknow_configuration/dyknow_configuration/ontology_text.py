"""The ontology of a robot.yaml, in OWL (RDF/XML)."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator
from html import escape

from dyknow_configuration.robot import RobotFeature, RobotSort, RobotVocabulary

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


def ontology_text(vocabulary: RobotVocabulary, name: str) -> str:
    """Return the ontology of a vocabulary.

    Args:
        vocabulary: the sorts, objects and features.
        name: of the ontology, which becomes the prefix of its names.
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
