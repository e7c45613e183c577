"""Where the text of an ontology comes from: a file, this package, or the web."""

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

_ENDINGS: Final = ('.owl', '.rdf', '.xml', '.ttl', '.nt', '.ntriples')
_ACCEPTED: Final = 'application/rdf+xml, application/n-triples, application/owl+xml, text/turtle'
_WEB_TIMEOUT: Final = 10.0
"""How long a server may stay silent, in seconds."""


@dataclass(frozen=True, slots=True)
class OntologySource:
    """The text of an ontology.

    Args:
        place: where it was found, for messages.
        text: in RDF/XML, OWL/XML, N-Triples or Turtle.
        folder: where to look for what it imports; none if it came from the web.
    """

    place: str
    text: bytes
    folder: Path | None = None


def same_ontology(one: str, other: str) -> bool:
    """Whether two IRIs mean the same ontology; `#` or `/` at the end makes no difference."""
    return one.rstrip('#/') == other.rstrip('#/')


def read_source(path_or_iri: str) -> OntologySource:
    """The ontology at a path, at a `file:` IRI or at an address on the web.

    Raises:
        SemanticsError: if it cannot be read.
    """
    if same_ontology(path_or_iri, UPPER_ONTOLOGY):
        return upper_ontology()
    parts = urlsplit(path_or_iri)
    if parts.scheme in {'http', 'https'}:
        return _download(path_or_iri)
    return _read(Path(unquote(parts.path) if parts.scheme == 'file' else path_or_iri))


def read_import(iri: str, importer: OntologySource) -> OntologySource:
    """The ontology that another one imports: from beside it.

    The web is asked only where the importer was asked for by its address there.

    Raises:
        SemanticsError: if it is not there.
    """
    if same_ontology(iri, UPPER_ONTOLOGY):
        return upper_ontology()
    name = prefix_of(iri)
    if importer.folder is None:
        return _download(iri)
    for path in (importer.folder / (name + ending) for ending in _ENDINGS):
        if path.is_file():
            return _read(path)
    raise SemanticsError(
        f'{importer.place} imports <{iri}>, which is not loaded and not beside it; put it there as '
        f'{name}.owl (or {", ".join(_ENDINGS[1:])}), or load it first by its path or its address',
        ExitCode.NOT_FOUND,
    )


def upper_ontology() -> OntologySource:
    """The upper ontology that this package ships."""
    resource = files('dyknow_semantics').joinpath('ontology', 'dyknow.owl')
    return OntologySource(UPPER_ONTOLOGY, resource.read_bytes())


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
        with urlopen(request, timeout=_WEB_TIMEOUT) as answer:  # noqa: S310
            return OntologySource(iri, answer.read())
    except (OSError, HTTPException) as error:
        if isinstance(error, HTTPError):
            error.close()
        reason = getattr(error, 'reason', error)
        raise SemanticsError(f'cannot download <{iri}>: {reason}', ExitCode.UNAVAILABLE) from None
