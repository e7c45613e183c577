"""Classes of messages and the definitions that they are generated from have equal fields."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_common import sourced_prefixes
from dyknow_recordings.reading.messages.definitions import MessageTypes, TypeDefinition
from dyknow_recordings.reading.messages.layouts import TypeLayout
from dyknow_stream_processing import StreamError
from dyknow_stream_processing.ros import message_class, scalar_fields

TYPES = MessageTypes(prefixes=sourced_prefixes())

FILES = {
    f'{path.parent.parent.name}/msg/{path.stem}': path
    for prefix in reversed(sourced_prefixes())
    for path in sorted(prefix.glob('share/*/msg/*.msg'))
}


def test_types_are_installed() -> None:
    assert len(FILES) > 130


@pytest.mark.parametrize(('name', 'path'), FILES.items(), ids=FILES)
def test_fields_of_classes_and_definitions(name: str, path: Path) -> None:
    try:
        expected = scalar_fields(message_class(name))
    except StreamError:
        pytest.skip('it has a definition, but no Python class')
    definition = TypeDefinition(name, 'ros2msg', path.read_text(encoding='utf-8'))
    fields = TypeLayout(definition, TYPES).fields
    # A message without fields has one in its class, as C has no empty structures.
    expected.pop('structure_needs_at_least_one_member', None)
    assert list(fields.items()) == list(expected.items())
