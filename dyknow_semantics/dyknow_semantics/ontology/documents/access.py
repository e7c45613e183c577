"""Limits of what is read: the files and addresses that a request may name, and their size."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from dyknow_common import ExitCode, listed, shortened
from dyknow_semantics.errors import SemanticsError

MAX_BYTES: Final = 16 * 1024 * 1024
MAX_STATEMENTS: Final = 1_000_000


@dataclass(frozen=True, slots=True)
class Access:
    """The documents that one request may read.

    Args:
        folders: only files below these are read; `None` stands for all files.
        linked_folders: as `folders`, but links in them may lead out of them, as in packages that
            were installed with links to their sources.
        allow_download: whether `http` and `https` are allowed.
        max_bytes: the most bytes of a document with its imports.
        max_statements: the most statements of a document with its imports.
    """

    folders: tuple[Path, ...] | None = None
    linked_folders: tuple[Path, ...] = ()
    allow_download: bool = True
    max_bytes: int = MAX_BYTES
    max_statements: int = MAX_STATEMENTS

    def check_file(self, path: Path) -> None:
        """Check that a file may be read.

        Raises:
            SemanticsError: if it is in another folder, whether it exists or not.
        """
        if self.folders is None:
            return
        found = Path(os.path.realpath(path))
        written = Path(os.path.abspath(path))  # noqa: PTH100 - without `..`, and with links
        if not (
            any(found.is_relative_to(os.path.realpath(each)) for each in self.folders)
            or any(written.is_relative_to(each) for each in self.linked_folders)
        ):
            folders = listed(dict.fromkeys((*self.folders, *self.linked_folders)))
            raise SemanticsError(
                f"'{shortened(path)}' is outside of the folders that ontologies are loaded from "
                f'({folders or "none"}); move it there, or add its folder to ontology_path'
            )

    def check_download(self, iri: str) -> None:
        """Check that an ontology may be downloaded.

        Raises:
            SemanticsError: if it may not.
        """
        if not self.allow_download:
            raise SemanticsError(
                f'<{shortened(iri)}> is on the web, and nothing is downloaded; set allow_download, '
                'or load the ontology from a file'
            )

    def check_size(self, location: str, size: int) -> None:
        """Check the number of bytes of a document, or of a document with its imports.

        Raises:
            SemanticsError: if it has too many.
        """
        if size > self.max_bytes:
            raise SemanticsError(
                f"'{shortened(location)}' has, with its imports, more than {self.max_bytes:,} "
                'bytes; split it, or increase max_bytes'
            )

    def check_statements(self, location: str, number: int) -> None:
        """Check the number of statements of a document with its imports.

        Raises:
            SemanticsError: if it has too many.
        """
        if number > self.max_statements:
            raise SemanticsError(
                f"'{shortened(location)}' has, with its imports, more than "
                f'{self.max_statements:,} statements; split it, or increase max_statements'
            )


def cannot_read(path: Path, error: OSError | ValueError) -> SemanticsError:
    """Return the error for a file that cannot be read."""
    reason = getattr(error, 'strerror', None) or str(error)
    return SemanticsError(
        f"cannot read the ontology '{shortened(path)}': {reason}", ExitCode.NOT_FOUND
    )
