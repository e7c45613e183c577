"""Serialisations of OWL: recognition, translation, and the prefixes that a text declares.

owlready2 reads RDF/XML, OWL/XML and N-Triples. rdflib translates all else to N-Triples.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final, Literal
from xml.etree.ElementTree import ParseError, iterparse
from xml.sax import SAXParseException
from xml.sax.saxutils import quoteattr

from rdflib import Graph
from rdflib.exceptions import ParserError
from rdflib.plugins.parsers.notation3 import BadSyntax
from rdflib.plugins.parsers.ntriples import NTGraphSink, W3CNTriplesParser

from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.documents.sources import OntologySource
from dyknow_semantics.ontology.vocabulary import LANGUAGES, OWL, RDF, UPPER_ONTOLOGY

OwlreadyFormat = Literal['rdfxml', 'owlxml', 'ntriples']

_FORMAT_OF_ROOT: Final[dict[str, OwlreadyFormat]] = {
    f'{{{RDF}}}RDF': 'rdfxml',
    f'{{{OWL}}}Ontology': 'owlxml',
}
_PREFIX: Final = f'{{{OWL}}}Prefix'
_BASE: Final = '{http://www.w3.org/XML/1998/namespace}base'
_TURTLE_EXTENSIONS: Final = ('.ttl', '.turtle')
_DIRECTIVE: Final = re.compile(rb'(?:\s|#[^\n]*\n)*@?(?:prefix|base)\s', re.IGNORECASE)
_TURTLE_PREFIX: Final = r'(?im)^[^\S\n]*@?prefix\s+([\w.-]*):\s*<([^>\s]*)>'
MAX_REASON: Final = 400
"""The number of characters of the error of a parser that a message has."""

_REASON: Final = re.compile(r'Bad syntax \((.*)\) at \^', re.DOTALL)


@dataclass(frozen=True, slots=True)
class OntologyText:
    """The text of an ontology in a format that owlready2 reads.

    Args:
        location: path or address, for messages.
        prefixes: the declared prefixes, each with its namespace.
    """

    location: str
    format: OwlreadyFormat
    content: bytes
    prefixes: frozenset[tuple[str, str]] = frozenset()


def normalise(source: OntologySource, base: str) -> OntologyText:
    """Return the text of an ontology in a format that owlready2 reads.

    `base` is the base of relative IRIs in Turtle.

    Raises:
        SemanticsError: if the text is malformed or in another format.
    """
    form = source.format or _recognised(source)
    if form == 'turtle':
        # rdflib keeps only one of several prefixes of a namespace.
        declarations = re.findall(_TURTLE_PREFIX, source.text.decode(errors='replace'))
        content = _translate(source, 'turtle', base)
        prefixes = _usable_prefixes(declarations)
        return OntologyText(source.location, 'ntriples', content, prefixes)
    if form in _FORMAT_OF_ROOT.values():
        return _normalise_xml(source)
    return OntologyText(source.location, 'ntriples', source.text)


def fault_in_ntriples(content: bytes) -> str:
    """Return the first line of a text that is no statement in N-Triples, as a message, or ''."""
    parser = W3CNTriplesParser(NTGraphSink(Graph()))
    for number, line in enumerate(content.decode(errors='replace').splitlines(), 1):
        try:
            parser.parsestring(line)
        except ParserError:
            return (
                f'line {number} is no statement in N-Triples; a text in Turtle begins with @prefix'
            )
    return ''


def _recognised(source: OntologySource) -> str:
    """Return the format of a text; for XML, its root shows later which of the two it is."""
    if source.location.endswith(_TURTLE_EXTENSIONS) or _DIRECTIVE.match(source.text):
        return 'turtle'
    start = source.text.lstrip(b'\xef\xbb\xbf \t\r\n')
    return 'rdfxml' if start.startswith((b'<?', b'<!', b'<rdf:', b'<Onto')) else 'ntriples'


def _normalise_xml(source: OntologySource) -> OntologyText:
    try:
        root, base, declarations = _xml_head(source.text)
        form, text = _FORMAT_OF_ROOT.get(root), source.text
        if form == 'owlxml':
            text = _with_declarations(text, dict(declarations))
    except ParseError as error:
        raise unreadable(source.location, f'parsing error: {error}') from None
    if form is None:
        raise unreadable(
            source.location,
            f'its root is {root}; write it as RDF/XML, OWL/XML, N-Triples or Turtle',
        )
    prefixes = _usable_prefixes(declarations)
    if '#' in base:
        # owlready2 keeps the fragment of a base: `#Wine` becomes `wine##Wine`.
        content = _translate(source, 'xml', base)
        return OntologyText(source.location, 'ntriples', content, prefixes)
    return OntologyText(source.location, form, text, prefixes)


def _xml_head(text: bytes) -> tuple[str, str, list[tuple[str, str]]]:
    """Return the root of an XML text, its base, and the prefixes declared at it or right below."""
    declared: list[tuple[str, str]] = []
    root = base = ''
    # Expat limits the expansion of entities since version 2.4.
    events: Iterator[tuple[str, Any]] = iterparse(BytesIO(text), ('start-ns', 'start'))  # noqa: S314
    for event, item in events:
        if event == 'start-ns':
            declared.append(item)
        elif not root:
            root, base = item.tag, item.get(_BASE, '')
        elif item.tag == _PREFIX:
            declared.append((item.get('name', ''), item.get('IRI', '')))
        else:
            break
    return root, base, declared


def _with_declarations(text: bytes, prefixes: Mapping[str, str]) -> bytes:
    """Return a text in OWL/XML that declares its classes, for owlready2 ignores all others.

    Those of OWL and of the ontology of DyKnow itself are declared elsewhere.
    """
    used: dict[tuple[str, str], None] = {}
    declared: set[tuple[str, str]] = set()
    is_declaration = False
    for event, element in iterparse(BytesIO(text), ('start', 'end')):  # noqa: S314 - see _xml_head
        if event == 'end':
            element.clear()  # So the memory for large files stays small.
            continue
        names = [each for each in element.items() if each[0] in {'IRI', 'abbreviatedIRI'}]
        if element.tag != f'{{{OWL}}}Class':
            is_declaration = element.tag == f'{{{OWL}}}Declaration'
        elif is_declaration:
            declared.update(names)
        else:
            used |= dict.fromkeys(names)
    found = ''
    for attribute, name in used:
        prefix, _, local = name.partition(':')
        iri = name if attribute == 'IRI' else f'{prefixes.get(prefix, OWL)}{local}'
        if (attribute, name) not in declared and not iri.startswith((OWL, UPPER_ONTOLOGY)):
            found += (
                f'<Declaration xmlns="{OWL}"><Class {attribute}={quoteattr(name)}/></Declaration>'
            )
    head, end, tail = text.rpartition(b'</')
    return head + found.encode('ascii', 'xmlcharrefreplace') + end + tail


def _translate(source: OntologySource, rdflib_format: Literal['turtle', 'xml'], base: str) -> bytes:
    """Return a text in N-Triples."""
    graph = Graph(bind_namespaces='none')
    try:
        graph.parse(data=source.text, format=rdflib_format, publicID=base)
    except BadSyntax as error:
        reason = _REASON.search(str(error))
        raise unreadable(
            source.location, f'line {error.lines + 1}: {reason[1] if reason else error}'
        ) from None
    except (SAXParseException, ParserError) as error:
        raise unreadable(source.location, f'parsing error: {error}') from None
    except UnicodeDecodeError:
        raise unreadable(source.location, 'it is not in UTF-8') from None
    except (MemoryError, RecursionError):
        raise
    except Exception as error:  # noqa: BLE001 - rdflib raises any, at malformed texts
        raise unreadable(source.location, f'{type(error).__name__}: {error}') from None
    return graph.serialize(format='nt', encoding='utf-8')


def _usable_prefixes(declarations: Iterable[tuple[str, str]]) -> frozenset[tuple[str, str]]:
    """Leave out empty prefixes, and prefixes of OWL, RDF and the like."""
    return frozenset(
        (prefix, namespace)
        for prefix, namespace in declarations
        if re.fullmatch(r'[A-Za-z_][\w-]*', prefix)
        and namespace.endswith(('#', '/'))
        and namespace not in LANGUAGES
    )


def unreadable(location: str, reason: str) -> SemanticsError:
    """Return the error for a text that is malformed or in another format."""
    return SemanticsError(f'cannot read an ontology: {location}: {reason[:MAX_REASON]}')
