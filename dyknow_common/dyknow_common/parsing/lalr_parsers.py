"""Parsers of grammars, kept in the cache folder of the user.

Lark needs 0.05 to 0.15 s to make the tables of a grammar, which is a third of the time that a
command needs until its first line. Loading them takes 0.01 s. A file of the cache contains what its
parser was made from, so another version of lark or of a grammar replaces it; and it is compressed
with a checksum, so damage is noticed. Without a folder that can be written, each process makes its
own tables.
"""

from __future__ import annotations

import os
import pickle
import zlib
from contextlib import suppress
from importlib.resources import files
from io import BytesIO
from pathlib import Path
from typing import Any

import lark

from dyknow_common.constraints import constraint_grammar
from dyknow_common.text_files import replace_file

_SHARED_PACKAGE = 'dyknow_common'
_SHARED_GRAMMAR = 'common.lark'


class _Tables(pickle.Unpickler):
    """Reads numbers and texts; a file that would call anything else is refused."""

    def find_class(self, module: str, name: str) -> type[lark.Token]:
        """Return the class of texts with positions."""
        if (module, name) != (lark.Token.__module__, lark.Token.__name__):
            raise pickle.UnpicklingError(f'unexpected {module}.{name}')
        return lark.Token


def lalr_parser(package: str, grammar: str, start: str) -> lark.Lark:
    """Return the parser of a grammar.

    Args:
        package: the Python package that holds the grammar.
        grammar: the name of the `.lark` file in that package.
        start: the rule of a whole text.
    """
    text = files(package).joinpath(grammar).read_text(encoding='utf-8')
    if 'constraint' in text:
        text += constraint_grammar()
    shared = files(_SHARED_PACKAGE).joinpath(_SHARED_GRAMMAR).read_text(encoding='utf-8')
    origin = (lark.__version__, text, shared, start)
    path = _path(f'{Path(grammar).stem}-{zlib.crc32(repr(origin).encode()):08x}')
    if path is not None and (tables := _read(path, origin)) is not None:
        return lark.Lark.load(tables)
    parser = lark.Lark(
        text,
        parser='lalr',
        start=start,
        propagate_positions=True,
        import_paths=[str(files(_SHARED_PACKAGE))],
    )
    if path is not None:
        _write(path, origin, parser)
    return parser


def _path(name: str) -> Path | None:
    """Return the file of a parser; None if the user has no home."""
    try:
        folder = Path(os.environ.get('XDG_CACHE_HOME') or Path.home() / '.cache')
    except RuntimeError:
        return None
    return folder / 'dyknow' / 'parsers' / name


def _read(path: Path, origin: tuple[str, ...]) -> Any:
    """Return the tables in a file; None if it has none of this origin."""
    try:
        content = BytesIO(zlib.decompress(path.read_bytes()))
        return _Tables(content).load() if _Tables(content).load() == origin else None
    except (OSError, zlib.error, pickle.UnpicklingError):
        return None


def _write(path: Path, origin: tuple[str, ...], parser: lark.Lark) -> None:
    content = BytesIO()
    pickle.dump(origin, content)
    parser.save(content)
    with suppress(OSError):  # Such as a file system that is read only.
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        replace_file(path, zlib.compress(content.getvalue()), 0o600)
