"""Parsers that are kept in the cache folder of the user."""

from __future__ import annotations

import os
import pickle
import zlib
from collections.abc import Callable
from pathlib import Path

import lark
import pytest

from dyknow_common.parsing.lalr_parsers import lalr_parser

TEXTS = ('max_delay = 1.5 s', 'max_delay=5 days', 'max_delay5 s', 'max_delay=', 'delay=5 s')


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path))
    return tmp_path / 'dyknow' / 'parsers'


def constraint_parser() -> lark.Lark:
    return lalr_parser('dyknow_common', 'common.lark', 'constraint')


def results(parser: lark.Lark) -> list[object]:
    found: list[object] = []
    for text in TEXTS:
        try:
            found.append(parser.parse(text))
        except lark.UnexpectedInput as error:
            found.append(f'{type(error).__name__} {error.line}:{error.column}')
    return found


def forbid_making(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object, **__: object) -> None:
        raise AssertionError('made again')

    monkeypatch.setattr(lark.Lark, '__init__', fail)


def test_a_parser_from_the_cache_is_the_same(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = results(constraint_parser())
    (file,) = cache.iterdir()
    assert file.stat().st_mode & 0o777 == 0o600
    assert cache.stat().st_mode & 0o777 == 0o700
    forbid_making(monkeypatch)
    assert results(constraint_parser()) == expected


def truncated(content: bytes) -> bytes:
    return content[:-10]


def altered(content: bytes) -> bytes:
    return content[:500] + bytes([content[500] ^ 1]) + content[501:]


def of_another_grammar(content: bytes) -> bytes:
    return zlib.compress(zlib.decompress(content).replace(b'max_delay', b'max_decay'))


def with_a_function(_: bytes) -> bytes:
    return zlib.compress(pickle.dumps(os.getcwd))


@pytest.mark.parametrize(
    'damage', [truncated, altered, of_another_grammar, with_a_function, lambda _: b'']
)
def test_a_damaged_file_is_replaced(
    cache: Path, monkeypatch: pytest.MonkeyPatch, damage: Callable[[bytes], bytes]
) -> None:
    expected = results(constraint_parser())
    (file,) = cache.iterdir()
    file.write_bytes(damage(file.read_bytes()))
    assert results(constraint_parser()) == expected
    forbid_making(monkeypatch)
    assert results(constraint_parser()) == expected


def test_another_version_of_lark_makes_its_own(
    cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    constraint_parser()
    monkeypatch.setattr(lark, '__version__', '9.9')
    constraint_parser()
    assert len(list(cache.iterdir())) == 2


def test_no_folder_can_be_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    expected = results(constraint_parser())
    (tmp_path / 'file').touch()
    monkeypatch.setenv('XDG_CACHE_HOME', str(tmp_path / 'file'))
    assert results(constraint_parser()) == expected

    def fail() -> Path:
        raise RuntimeError('Could not determine home directory.')

    monkeypatch.delenv('XDG_CACHE_HOME')
    monkeypatch.setattr(Path, 'home', fail)
    assert results(constraint_parser()) == expected
