"""Reading the text of an ontology from a file, this package, or the web."""

from __future__ import annotations

from dataclasses import dataclass
from http.client import HTTPException
from importlib.resources import files
from pathlib import Path
from typing import Final
from urllib.error import HTTPError
from urllib.parse import unquote, urlsplit
from urllib.request import Request, urlopen

from dyknow_common import ExitCode
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.names import prefix_of
from dyknow_semantics.ontology.vocabulary import UPPER_ONTOLOGY

FORMATS: Final = ('rdfxml', 'owlxml', 'ntriples', 'turtle')
"""The names of the formats of a text."""

_MAX_TEXT: Final = 4 * 1024 * 1024
"""The largest text of an ontology in a request, in bytes."""

_EXTENSIONS: Final = ('.owl', '.rdf', '.xml', '.ttl', '.nt', '.ntriples')
_ACCEPTED: Final = 'application/rdf+xml, application/n-triples, application/owl+xml, text/turtle'
_WEB_TIMEOUT_S: Final = 10.0
"""The longest silence of a web server."""


@dataclass(frozen=True, slots=True)
class OntologySource:
    """The text of an ontology.

    Args:
        location: path or address, for messages.
        text: RDF/XML, OWL/XML, N-Triples or Turtle.
        folder: the folder of its imports, if it has one.
        format: one of `FORMATS`; empty if it is to be recognised.
        is_from_web: True if its imports are downloaded too.
    """

    location: str
    text: bytes
    folder: Path | None = None
    format: str = ''
    is_from_web: bool = False


def same_ontology(one: str, other: str) -> bool:
    """Return True if two IRIs name the same ontology; a final `#` or `/` is ignored."""
    return one.rstrip('#/') == other.rstrip('#/')


def read_source(path_or_iri: str) -> OntologySource:
    """Read the ontology at a path, at a `file:` IRI or at an address on the web.

    Raises:
        SemanticsError: if it cannot be read.
    """
    if same_ontology(path_or_iri, UPPER_ONTOLOGY):
        resource = files('dyknow_semantics').joinpath('ontology', 'dyknow.owl')
        return OntologySource(UPPER_ONTOLOGY, resource.read_bytes())
    parts = urlsplit(path_or_iri)
    if parts.scheme in {'http', 'https'}:
        return _download(path_or_iri)
    return _read(Path(unquote(parts.path) if parts.scheme == 'file' else path_or_iri))


def source_of_text(text: str, format_: str) -> OntologySource:
    """Return the source of a text in a request.

    Raises:
        SemanticsError: if the format is unknown, or the text is too large.
    """
    if format_ not in {'', *FORMATS}:
        raise SemanticsError(
            f"the format '{format_}' is unknown; give one of {', '.join(FORMATS)}, or none"
        )
    content = text.encode()
    if len(content) > _MAX_TEXT:
        raise SemanticsError(
            f'the content has {len(content):,} bytes, more than {_MAX_TEXT:,}; '
            'load the ontology from a file or the web, or split it'
        )
    return OntologySource('the content', content, format=format_)


def read_import(iri: str, importer: OntologySource) -> OntologySource:
    """Read an imported ontology, which lies beside its importer.

    It is downloaded only if its importer was downloaded.

    Raises:
        SemanticsError: if it is not found.
    """
    if same_ontology(iri, UPPER_ONTOLOGY):
        return read_source(iri)
    if importer.is_from_web:
        return _download(iri)
    if importer.folder is None:
        raise SemanticsError(
            f'{importer.location} imports <{iri}>, which is not loaded; load it first',
            ExitCode.NOT_FOUND,
        )
    name = prefix_of(iri)
    for path in (importer.folder / (name + extension) for extension in _EXTENSIONS):
        if path.is_file():
            return _read(path)
    raise SemanticsError(
        f'{importer.location} imports <{iri}>, which is not loaded and not beside it; put it there '
        f'as {name}.owl (or {", ".join(_EXTENSIONS[1:])}), or load it first by its path or its '
        'address',
        ExitCode.NOT_FOUND,
    )


def _read(path: Path) -> OntologySource:
    try:
        return OntologySource(str(path), path.read_bytes(), path.parent)
    except OSError as error:
        reason = error.strerror or str(error)
        raise SemanticsError(
            f"cannot read the ontology '{path}': {reason}", ExitCode.NOT_FOUND
        ) from None


def _download(iri: str) -> OntologySource:
    request = Request(iri, headers={'Accept': _ACCEPTED})  # noqa: S310 - http and https only
    try:
        with urlopen(request, timeout=_WEB_TIMEOUT_S) as response:  # noqa: S310
            return OntologySource(iri, response.read(), is_from_web=True)
    except (OSError, HTTPException) as error:
        if isinstance(error, HTTPError):
            error.close()
        reason = getattr(error, 'reason', error)
        raise SemanticsError(f'cannot download <{iri}>: {reason}', ExitCode.UNAVAILABLE) from None
