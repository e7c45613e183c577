"""Files of stores: private, checked before use, never overwritten when they cannot be read."""

from __future__ import annotations

import os
import sqlite3
from collections.abc import Callable
from contextlib import closing
from pathlib import Path
from typing import Any

import pytest

from dyknow_common import ExitCode
from dyknow_semantics import AnnotationStore, Ontology, SemanticsError, parse_annotations

STORES: list[Callable[[Path], Any]] = [Ontology, AnnotationStore]


@pytest.fixture(params=STORES, ids=['ontology', 'annotations'])
def store(request: pytest.FixtureRequest) -> Callable[[Path], Any]:
    """A kind of store."""
    found: Callable[[Path], Any] = request.param
    return found


def damage_truncate(file: Path) -> None:
    os.truncate(file, file.stat().st_size - 5000)


def damage_page(file: Path) -> None:
    with file.open('r+b') as opened:
        opened.seek(100)
        opened.write(b'\xff' * 4000)


def damage_header(file: Path) -> None:
    file.write_bytes(b'damaged' + file.read_bytes())


def newer_version(file: Path) -> None:
    with closing(sqlite3.connect(file)) as connection, connection:
        connection.execute('PRAGMA user_version = 99')
        if connection.execute("SELECT 1 FROM sqlite_master WHERE name = 'store'").fetchone():
            connection.execute('UPDATE store SET version = 99')


def other_tables(file: Path) -> None:
    file.unlink()
    with closing(sqlite3.connect(file)) as connection, connection:
        connection.execute('CREATE TABLE other (x)')


def test_only_the_owner_may_read_a_store(store: Callable[[Path], Any], tmp_path: Path) -> None:
    file = tmp_path / 'store'
    with closing(store(file)):
        assert {each.stat().st_mode & 0o777 for each in tmp_path.glob('store*')} == {0o600}


@pytest.mark.parametrize(
    ('damage', 'word'),
    [
        (damage_truncate, 'backup'),
        (damage_page, 'backup'),
        (damage_header, 'backup'),
        (newer_version, 'version 99'),
        (other_tables, 'the tables other'),
    ],
)
def test_an_unusable_store_is_refused_and_left(
    store: Callable[[Path], Any], tmp_path: Path, damage: Callable[[Path], None], word: str
) -> None:
    file = tmp_path / 'store'
    store(file).close()
    damage(file)
    before = file.read_bytes()
    with pytest.raises(SemanticsError) as error:
        store(file)
    assert error.value.code is ExitCode.UNAVAILABLE
    assert word in error.value.message
    assert str(file) in error.value.message
    assert file.read_bytes() == before


def test_stores_of_the_other_kind(tmp_path: Path) -> None:
    Ontology(tmp_path / 'ontology').close()
    AnnotationStore(tmp_path / 'annotations').close()
    for store, name in ((Ontology, 'annotations'), (AnnotationStore, 'ontology')):
        with pytest.raises(SemanticsError, match='which are not those of such a store'):
            store(tmp_path / name)


def test_no_regular_file(store: Callable[[Path], Any], tmp_path: Path) -> None:
    os.mkfifo(tmp_path / 'pipe')
    for path in (tmp_path, tmp_path / 'pipe', Path('/dev/null')):
        with pytest.raises(SemanticsError, match='cannot open'):
            store(path)


def test_a_full_disk_changes_nothing(tmp_path: Path) -> None:
    with Ontology(tmp_path / 'store') as ontology:
        ontology.create_concept('Vehicle', ['Object'])
        database = ontology._store._world.graph.db
        (pages,) = database.execute('PRAGMA page_count').fetchone()
        database.execute(f'PRAGMA max_page_count = {pages}')

        def fill() -> None:
            for number in range(10_000):
                ontology.create_instance(f'{"x" * 900}{number}', ['Vehicle'])

        with pytest.raises(SemanticsError, match='free space') as error:
            fill()
        assert error.value.code is ExitCode.UNAVAILABLE
        before = ontology.knowledge.instances('Vehicle')
        ontology.create_instance('last', ['Vehicle'])
        assert {*ontology.knowledge.instances('Vehicle')} == {*before, 'last'}
    with closing(AnnotationStore(tmp_path / 'annotations')) as store:
        store._connection.execute('PRAGMA max_page_count = 1')

        def fill_annotations() -> None:
            for number in range(1000):
                store.add(parse_annotations(f'stream a{number} contains P[u] = {"p" * 500};'))

        with pytest.raises(SemanticsError, match='free space'):
            fill_annotations()
        assert len(store.texts) < 1000
