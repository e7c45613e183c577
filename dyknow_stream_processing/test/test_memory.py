"""What a stream manager keeps over its restart."""

import pytest

from dyknow_stream_processing import DyKnowError, StreamConstraints
from dyknow_stream_processing.memory import read_memory, write_memory
from dyknow_stream_processing.registry import CreatedStream, RegisteredStream

BATTERY = RegisteredStream('battery', '/uav1/battery', 'sensor_msgs/msg/BatteryState')
POWER = CreatedStream(
    'power', 'select a from battery', StreamConstraints(max_delay=5), '/e1', '/streams/power'
)


def test_what_is_written_is_read() -> None:
    battery, power = read_memory(write_memory([BATTERY, POWER]))
    assert battery == BATTERY
    assert isinstance(power, CreatedStream)
    assert (power.name, power.specification) == (POWER.name, POWER.specification)
    assert power.constraints == POWER.constraints
    assert power.waits


@pytest.mark.parametrize(
    ('text', 'words'),
    [
        ('{', 'not what a stream manager wrote'),
        ('[]', 'not what a stream manager wrote'),
        ('{"streams": [{"name": "a"}]}', 'not what a stream manager wrote'),
        ('{"streams": [{"name": "a", "specification": "x", "constraints": {"b": 1}}]}', 'wrote'),
        ('{"streams": [{"name": "a", "specification": "select", "constraints": {}}]}', 'expected'),
    ],
)
def test_what_is_no_memory(text: str, words: str) -> None:
    with pytest.raises(DyKnowError, match=words):
        read_memory(text)
