"""The forms that OWL is written in: which one a text has, and the prefixes that it declares."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from io import BytesIO
from typing import Any, Final, Literal
from xml.etree.ElementTree import ParseError, iterparse
from xml.sax import SAXParseException

from rdflib import Graph
from rdflib.exceptions import ParserError
from rdflib.plugins.parsers.notation3 import BadSyntax

from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.sources import OntologySource
from dyknow_semantics.ontology.vocabulary import LANGUAGES, OWL, RDF

Form = Literal['rdfxml', 'owlxml', 'ntriples']
"""A form that owlready2 reads."""

Prefixes = frozenset[tuple[str, str]]
"""Prefixes, each with the namespace that it stands for."""

_ROOTS: Final[dict[str, Form]] = {f'{{{RDF}}}RDF': 'rdfxml', f'{{{OWL}}}Ontology': 'owlxml'}
_PREFIX: Final = f'{{{OWL}}}Prefix'
_BASE: Final = '{http://www.w3.org/XML/1998/namespace}base'
_TURTLE_ENDINGS: Final = ('.ttl', '.turtle')
_DIRECTIVE: Final = re.compile(rb'(?:\s|#[^\n]*\n)*@?(?:prefix|base)\s', re.IGNORECASE)
_TURTLE_PREFIX: Final = r'(?im)^\s*@?prefix\s+([\w.-]*):\s*<([^>\s]*)>'
_REASON: Final = re.compile(r'Bad syntax \((.*)\) at \^', re.DOTALL)


@dataclass(frozen=True, slots=True)
class OntologyText:
    """A text that owlready2 reads.

    Args:
        form: what it is written in.
        content: the text.
        prefixes: those declared in it.
    """

    form: Form
    content: bytes
    prefixes: Prefixes = frozenset()


def recognise(source: OntologySource, base: str) -> OntologyText:
    """The text of an ontology with its form; rdflib translates what owlready2 cannot read.

    Args:
        source: RDF/XML, OWL/XML, N-Triples or Turtle.
        base: what relative IRIs in Turtle are relative to.

    Raises:
        SemanticsError: if it has none of these forms.
    """
    if source.place.endswith(_TURTLE_ENDINGS) or _DIRECTIVE.match(source.text):
        # rdflib forgets all but one of several prefixes for a namespace.
        declarations = re.findall(_TURTLE_PREFIX, source.text.decode(errors='replace'))
        return OntologyText(
            'ntriples', _translate(source, 'turtle', base), _vocabularies(declarations)
        )
    if source.text.lstrip(b'\xef\xbb\xbf \t\r\n').startswith((b'<?', b'<!', b'<rdf:', b'<Onto')):
        return _recognise_xml(source)
    return OntologyText('ntriples', source.text)


def _recognise_xml(source: OntologySource) -> OntologyText:
    try:
        root, base, declarations = _head(source.text)
    except ParseError as error:
        raise _unreadable(source, f'parsing error: {error}') from None
    if root not in _ROOTS:
        raise _unreadable(
            source, f'its root is {root}; write it as RDF/XML, OWL/XML, N-Triples or Turtle'
        )
    prefixes = _vocabularies(declarations)
    if '#' in base:
        # owlready2 does not drop the fragment of a base: `#Wine` becomes `wine##Wine`.
        return OntologyText('ntriples', _translate(source, 'xml', base), prefixes)
    return OntologyText(_ROOTS[root], source.text, prefixes)


def _head(text: bytes) -> tuple[str, str, list[tuple[str, str]]]:
    """The root of a text in XML, its base, and the prefixes declared at it or right below."""
    declared: list[tuple[str, str]] = []
    root = base = ''
    for event, item in _events(text):
        if event == 'start-ns':
            declared.append(item)
        elif not root:
            root, base = item.tag, item.get(_BASE, '')
        elif item.tag == _PREFIX:
            declared.append((item.get('name', ''), item.get('IRI', '')))
        else:
            break
    return root, base, declared


def _events(text: bytes) -> Iterator[tuple[str, Any]]:
    # Expat has been safe from entities that explode since its version 2.4.
    return iterparse(BytesIO(text), ('start-ns', 'start'))  # noqa: S314


def _translate(source: OntologySource, form: Literal['turtle', 'xml'], base: str) -> bytes:
    """A text in N-Triples, by rdflib."""
    graph = Graph(bind_namespaces='none')
    try:
        graph.parse(data=source.text, format=form, publicID=base)
    except BadSyntax as error:
        reason = _REASON.search(str(error))
        raise _unreadable(
            source, f'line {error.lines + 1}: {reason[1] if reason else error}'
        ) from None
    except (SAXParseException, ParserError) as error:
        raise _unreadable(source, f'parsing error: {error}') from None
    except UnicodeDecodeError:
        raise _unreadable(source, 'it is not in UTF-8') from None
    return graph.serialize(format='nt', encoding='utf-8')


def _vocabularies(declarations: Iterable[tuple[str, str]]) -> Prefixes:
    """Leaves out languages, which are no vocabularies of the world, and prefixes without name."""
    return frozenset(
        (prefix, namespace)
        for prefix, namespace in declarations
        if re.fullmatch(r'[A-Za-z_][\w-]*', prefix)
        and namespace.endswith(('#', '/'))
        and namespace not in LANGUAGES
    )


def _unreadable(source: OntologySource, reason: str) -> SemanticsError:
    return SemanticsError(f'cannot read an ontology: {source.place}: {reason}')
