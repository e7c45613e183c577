"""The fields of the samples of built-in sources, `tf("map", "base_link").yaw`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Final, NamedTuple

from dyknow_common.values import ValueType


class SourceField(NamedTuple):
    """A field of a built-in source.

    Args:
        type: the type of its values.
        unit: the unit of its values; empty for none.
    """

    type: ValueType
    unit: str = ''


_METRES: Final = SourceField(ValueType.FLOAT, 'm')
_TEXT: Final = SourceField(ValueType.STRING)

SOURCE_FIELDS: Final[Mapping[str, Mapping[str, SourceField]]] = {
    'tf': {
        **dict.fromkeys((f'translation.{axis}' for axis in 'xyz'), _METRES),
        **dict.fromkeys((f'rotation.{part}' for part in 'xyzw'), SourceField(ValueType.FLOAT)),
        'yaw': SourceField(ValueType.FLOAT, 'rad'),
        'distance': _METRES,
    },
    'action': {'name': _TEXT, 'status': SourceField(ValueType.INT), 'goal_id': _TEXT},
    'rate': {'hz': SourceField(ValueType.FLOAT, 'Hz')},
}
"""The fields of each source, by its name; an example comes first."""
