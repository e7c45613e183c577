"""Reading the text of an ontology from a file, this package, or the web."""

from __future__ import annotations

from dataclasses import dataclass
from http.client import HTTPException
from importlib.resources import files
from pathlib import Path
from typing import Any, Final
from urllib.error import HTTPError, URLError
from urllib.parse import unquote, urlsplit
from urllib.request import (
    HTTPDefaultErrorHandler,
    HTTPErrorProcessor,
    HTTPHandler,
    HTTPRedirectHandler,
    HTTPSHandler,
    OpenerDirector,
    ProxyHandler,
    Request,
)

from dyknow_common import ExitCode, shortened
from dyknow_common.text_files import read_regular
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.ontology.documents.access import Access, cannot_read
from dyknow_semantics.ontology.names import prefix_of
from dyknow_semantics.ontology.vocabulary import UPPER_ONTOLOGY

FORMATS: Final = ('rdfxml', 'owlxml', 'ntriples', 'turtle')
"""The names of the formats of a text."""

_MAX_TEXT: Final = 4 * 1024 * 1024
"""The largest text of an ontology in a request, in bytes."""

_EXTENSIONS: Final = ('.owl', '.rdf', '.xml', '.ttl', '.nt', '.ntriples')

_ACCEPTED: Final = 'application/rdf+xml, application/n-triples, application/owl+xml, text/turtle'
_WEB_TIMEOUT_S: Final = 10.0
"""The longest silence of a web server. Its worker process limits the time of a download."""

_SCHEMES: Final = {'http': 0, 'https': 1}
"""The schemes of addresses; a redirection never leads to a less secure one."""


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


def upper_ontology() -> bytes:
    """Return the text of the upper ontology, in RDF/XML."""
    return files('dyknow_semantics').joinpath('ontology', 'dyknow.owl').read_bytes()


def read_source(path_or_iri: str, access: Access) -> OntologySource:
    """Read the ontology at a path, at a `file:` IRI or at an address on the web.

    Raises:
        SemanticsError: if it cannot be read, or may not.
    """
    if same_ontology(path_or_iri, UPPER_ONTOLOGY):
        return OntologySource(UPPER_ONTOLOGY, upper_ontology())
    try:
        parts = urlsplit(path_or_iri)
    except ValueError as error:
        message = f"'{shortened(path_or_iri)}' is no path and no address: {error}"
        raise SemanticsError(message) from None
    if parts.scheme in {'http', 'https'}:
        return _download(path_or_iri, access)
    return _read(Path(unquote(parts.path) if parts.scheme == 'file' else path_or_iri), access)


def source_of_text(text: str, format_: str) -> OntologySource:
    """Return the source of a text in a request.

    Raises:
        SemanticsError: if the format is unknown, or the text is too large.
    """
    if format_ not in {'', *FORMATS}:
        raise SemanticsError(
            f"the format '{shortened(format_)}' is unknown; "
            f'give one of {", ".join(FORMATS)}, or none'
        )
    content = text.encode()
    if len(content) > _MAX_TEXT:
        raise SemanticsError(
            f'the content has {len(content):,} bytes, more than {_MAX_TEXT:,}; '
            'load the ontology from a file or the web, or split it'
        )
    return OntologySource('the content', content, format=format_)


def read_import(iri: str, importer: OntologySource, access: Access) -> OntologySource:
    """Read an imported ontology, which lies beside its importer.

    It is downloaded only if its importer was downloaded, which never reads a file.

    Raises:
        SemanticsError: if it is not found, or may not be read.
    """
    if same_ontology(iri, UPPER_ONTOLOGY):
        return read_source(iri, access)
    if importer.is_from_web:
        return _download(iri, access)
    if importer.folder is None:
        raise SemanticsError(
            f'{importer.location} imports <{shortened(iri)}>, which is not loaded; load it first',
            ExitCode.NOT_FOUND,
        )
    name = prefix_of(iri)
    for path in (importer.folder / (name + extension) for extension in _EXTENSIONS):
        if _is_file(path):
            return _read(path, access)
    raise SemanticsError(
        f'{importer.location} imports <{shortened(iri)}>, which is not loaded and not beside it; '
        f'put it there as {shortened(name)}.owl (or {", ".join(_EXTENSIONS[1:])}), or load it '
        'first by its path or its address',
        ExitCode.NOT_FOUND,
    )


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except (OSError, ValueError):
        return False  # The name is too long, or no name of a file.


def _read(path: Path, access: Access) -> OntologySource:
    try:
        access.check_file(path)
        content = read_regular(path, access.max_bytes)
    except (OSError, ValueError) as error:
        raise cannot_read(path, error) from None
    access.check_size(str(path), len(content))
    return OntologySource(str(path), content, path.parent)


def _download(iri: str, access: Access) -> OntologySource:
    access.check_download(iri)
    content = download(iri, access.max_bytes)
    access.check_size(iri, len(content))
    return OntologySource(iri, content, is_from_web=True)


class _Redirections(HTTPRedirectHandler):
    """Follows redirections to `http` and `https` only."""

    def redirect_request(
        self, req: Any, fp: Any, code: Any, msg: Any, headers: Any, newurl: str
    ) -> Any:
        scheme = urlsplit(newurl).scheme
        if _SCHEMES.get(scheme, -1) < _SCHEMES[req.type]:
            raise URLError(f"it redirects to an address of the scheme '{shortened(scheme)}'")
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def download(iri: str, max_bytes: int) -> bytes:
    """Return the content at an address, or its beginning: one byte more than a number of bytes.

    Raises:
        SemanticsError: UNAVAILABLE, if it cannot be downloaded; INVALID_ARGUMENT, if the address is
            not one of `http` or `https`.
    """
    try:
        if urlsplit(iri).scheme not in _SCHEMES:
            raise SemanticsError(
                f'cannot download <{shortened(iri)}>: its scheme is neither http nor https'
            )
        request = Request(iri, headers={'Accept': _ACCEPTED})  # noqa: S310 - http and https only
        with _opener().open(request, timeout=_WEB_TIMEOUT_S) as response:
            return bytes(response.read(max_bytes + 1))
    except (OSError, HTTPException, ValueError) as error:
        if isinstance(error, HTTPError):
            error.close()
        reason = shortened(getattr(error, 'reason', error))
        raise SemanticsError(
            f'cannot download <{shortened(iri)}>: {reason}', ExitCode.UNAVAILABLE
        ) from None


def _opener() -> OpenerDirector:
    """Return an opener without handlers of other schemes, such as `file` and `ftp`."""
    opener = OpenerDirector()
    for handler in (
        ProxyHandler(),
        HTTPHandler(),
        HTTPSHandler(),
        HTTPDefaultErrorHandler(),
        _Redirections(),
        HTTPErrorProcessor(),
    ):
        opener.add_handler(handler)
    return opener
