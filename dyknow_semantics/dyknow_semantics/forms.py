"""The forms that OWL is written in: which one a text has, and the prefixes that it declares."""

from __future__ import annotations

import re
from dataclasses import dataclass
from io import BytesIO
from typing import TYPE_CHECKING, Any, Final, Literal
from xml.etree.ElementTree import ParseError, iterparse

from rdflib import Graph
from rdflib.plugins.parsers.notation3 import BadSyntax

from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.vocabulary import OWL, RDF, W3C

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from dyknow_semantics.sources import Source

Form = Literal['rdfxml', 'owlxml', 'ntriples']
"""A form that owlready2 reads."""

Prefixes = frozenset[tuple[str, str]]
"""Prefixes, each with the namespace that it stands for."""

_ROOTS: Final[dict[str, Form]] = {f'{{{RDF}}}RDF': 'rdfxml', f'{{{OWL}}}Ontology': 'owlxml'}
_PREFIX: Final = f'{{{OWL}}}Prefix'
_TURTLE_ENDINGS: Final = ('.ttl', '.turtle')
_DIRECTIVE: Final = re.compile(rb'(?:\s|#[^\n]*\n)*@?(?:prefix|base)\s', re.IGNORECASE)
_REASON: Final = re.compile(r'Bad syntax \((.*)\) at \^', re.DOTALL)


@dataclass(frozen=True, slots=True)
class Text:
    """A text that owlready2 reads.

    Args:
        form: what it is written in.
        content: the text.
        prefixes: those declared in it.
    """

    form: Form
    content: bytes
    prefixes: Prefixes = frozenset()


def recognise(source: Source, base: str) -> Text:
    """The text of an ontology with its form; what is in Turtle is translated by rdflib.

    Args:
        source: RDF/XML, OWL/XML, N-Triples or Turtle.
        base: what relative IRIs in Turtle are relative to.

    Raises:
        SemanticsError: if it has none of these forms.
    """
    if source.place.endswith(_TURTLE_ENDINGS) or _DIRECTIVE.match(source.text):
        return _translate(source, base)
    if source.text.lstrip(b'\xef\xbb\xbf \t\r\n').startswith((b'<?', b'<!', b'<rdf:', b'<Onto')):
        return _recognise_xml(source)
    return Text('ntriples', source.text)


def _recognise_xml(source: Source) -> Text:
    try:
        root, declarations = _head(source.text)
    except ParseError as error:
        raise _unreadable(source, f'parsing error: {error}') from None
    if root not in _ROOTS:
        raise _unreadable(
            source, f'its root is {root}; write it as RDF/XML, OWL/XML, N-Triples or Turtle'
        )
    return Text(_ROOTS[root], source.text, _vocabularies(declarations))


def _head(text: bytes) -> tuple[str, list[tuple[str, str]]]:
    """The root of a text in XML, and the prefixes declared at it or right below."""
    declared: list[tuple[str, str]] = []
    root = ''
    for event, item in _events(text):
        if event == 'start-ns':
            declared.append(item)
        elif not root:
            root = item.tag
        elif item.tag == _PREFIX:
            declared.append((item.get('name', ''), item.get('IRI', '')))
        else:
            break
    return root, declared


def _events(text: bytes) -> Iterator[tuple[str, Any]]:
    # Expat has been safe from entities that explode since its version 2.4.
    return iterparse(BytesIO(text), ('start-ns', 'start'))  # noqa: S314


def _translate(source: Source, base: str) -> Text:
    graph = Graph(bind_namespaces='none')
    try:
        graph.parse(data=source.text, format='turtle', publicID=base)
    except BadSyntax as error:
        reason = _REASON.search(str(error))
        raise _unreadable(
            source, f'line {error.lines + 1}: {reason[1] if reason else error}'
        ) from None
    except UnicodeDecodeError:
        raise _unreadable(source, 'it is not in UTF-8') from None
    declarations = ((prefix, str(namespace)) for prefix, namespace in graph.namespaces())
    content = graph.serialize(format='nt', encoding='utf-8')
    return Text('ntriples', content, _vocabularies(declarations))


def _vocabularies(declarations: Iterable[tuple[str, str]]) -> Prefixes:
    """Leaves out languages, which are no vocabularies of the world, and prefixes without name."""
    return frozenset(
        (prefix, namespace)
        for prefix, namespace in declarations
        if re.fullmatch(r'[A-Za-z_][\w-]*', prefix)
        and namespace.endswith(('#', '/'))
        and not namespace.startswith(W3C)
    )


def _unreadable(source: Source, reason: str) -> SemanticsError:
    return SemanticsError(f'cannot read an ontology: {source.place}: {reason}')
