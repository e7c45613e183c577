"""The namespaces in which a stream manager looks for engines."""

import pytest

from dyknow_stream_processing import StreamError
from dyknow_stream_processing.management.naming import Namespaces, namespace_of


@pytest.mark.parametrize(
    ('names', 'own', 'inside', 'outside'),
    [
        ([], '/', ['/e', '/robot1/e'], []),
        ([], '/robot1', ['/robot1/e', '/robot1/arm/e'], ['/robot10/e', '/e', '/robot2/robot1/e']),
        ([''], '/robot1', ['/robot1/e'], ['/e']),
        (['/compute/', 'arm'], '/robot1', ['/compute/e', '/robot1/arm/e'], ['/robot1/e']),
        (['/'], '/robot1', ['/e', '/robot2/e'], []),
    ],
)
def test_boundaries_are_at_slashes(
    names: list[str], own: str, inside: list[str], outside: list[str]
) -> None:
    namespaces = Namespaces.of(names, own)
    assert all(map(namespaces.contain, inside))
    assert not any(map(namespaces.contain, outside))


@pytest.mark.parametrize('name', ['/a b', '//a', '1st', '/robot-1', '~/a'])
def test_what_is_no_namespace(name: str) -> None:
    with pytest.raises(StreamError, match=f"engine_namespaces: '{name}' cannot be a namespace"):
        Namespaces.of([name], '/robot1')


def test_the_namespace_of_a_node() -> None:
    assert namespace_of('/robot1/arm/e') == '/robot1/arm'
    assert namespace_of('/e') == ''
    assert str(Namespaces.of(['/a', '/'], '/')) == '/a, /'
