"""Annotations that are kept over the end of a process."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from dyknow_common import ExitCode
from dyknow_semantics import AnnotationStore, SemanticsError, parse_annotations

POWER = 'stream uav1_power contains Power[uav1] = power;'
TIMELY = 'stream uav1_power contains Power[uav1] = power with max_delay = 100 ms;'
HEAT = 'stream uav1_power contains Heat[uav1] = heat;'
GPS = 'stream "/uav1/gps" contains Altitude[uav1] = altitude [m];'


@pytest.fixture
def store() -> Iterator[AnnotationStore]:
    """A store that is forgotten."""
    store = AnnotationStore()
    yield store
    store.close()


def test_a_stream_has_several_annotations(store: AnnotationStore) -> None:
    store.add(parse_annotations(POWER + HEAT))
    store.add(parse_annotations(GPS + TIMELY))
    assert store.texts == (POWER, HEAT, GPS, TIMELY)
    assert [str(each) for each in store.remove('uav1_power')] == [POWER, HEAT, TIMELY]
    assert store.texts == (GPS,)
    assert [each.stream for each in store.by_text.values()] == ['/uav1/gps']


@pytest.mark.parametrize('text', [HEAT + POWER.replace('=', ' = '), HEAT + HEAT])
def test_the_same_annotation_twice_is_refused_with_all_beside_it(
    store: AnnotationStore, text: str
) -> None:
    store.add(parse_annotations(POWER))
    with pytest.raises(SemanticsError, match='there is already the annotation') as error:
        store.add(parse_annotations(text))
    assert error.value.code is ExitCode.ALREADY_EXISTS
    assert store.texts == (POWER,)


def test_an_unknown_stream_is_not_removed(store: AnnotationStore) -> None:
    store.add(parse_annotations(POWER))
    with pytest.raises(SemanticsError) as error:
        store.remove('uav2_power')
    assert error.value.code is ExitCode.NOT_FOUND
    assert error.value.message == ("stream 'uav2_power' has no annotation (there are: uav1_power)")


def test_annotations_survive_with_their_order(tmp_path: Path) -> None:
    file = tmp_path / 'annotations'
    for texts in (POWER + GPS, HEAT):
        store = AnnotationStore(file)
        store.add(parse_annotations(texts))
        store.close()
    store = AnnotationStore(file)
    assert store.texts == (POWER, GPS, HEAT)
    assert parse_annotations(POWER)[0] in store
    store.remove('uav1_power')
    store.close()
    store = AnnotationStore(file)
    assert store.texts == (GPS,)
    store.close()


def test_a_store_that_is_in_use_or_none(tmp_path: Path) -> None:
    (tmp_path / 'text').write_text('This is no store. ' * 100)
    used = AnnotationStore(tmp_path / 'used')
    for name in ('text', 'used', 'no/folder'):
        with pytest.raises(SemanticsError, match=f"annotations '{tmp_path / name}'") as error:
            AnnotationStore(tmp_path / name)
        assert error.value.code is ExitCode.UNAVAILABLE
    used.close()
