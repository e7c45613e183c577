"""Downloads of ontologies."""

from __future__ import annotations

from http.client import HTTPException
from typing import Any, Final
from urllib.error import HTTPError, URLError
from urllib.parse import urlsplit
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
from dyknow_semantics.errors import SemanticsError

_ACCEPTED: Final = 'application/rdf+xml, application/n-triples, application/owl+xml, text/turtle'
_WEB_TIMEOUT_S: Final = 10.0
"""The longest silence of a web server. Its worker process limits the time of a download."""

_SCHEMES: Final = {'http': 0, 'https': 1}
"""The schemes of addresses; a redirection never leads to a less secure one."""


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
