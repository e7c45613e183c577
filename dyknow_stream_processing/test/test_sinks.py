"""A text with many sinks, as the stream manager reads it at its start."""

import pytest

from dyknow_common import LanguageError
from dyknow_stream_processing import parse_specification, specifications_by_sink

FLEET = """
compunit power: float electrical_power((voltage: float, current: float));
stream one = select voltage, current from "uav1/battery";
stream one_power = electrical_power(one);
sink one_power;
stream two_power = electrical_power(select voltage, current from "uav2/battery");
sink two_power;
stream both = merge(one_power, two_power);
sink both
"""


def test_each_sink_gets_what_it_needs_and_no_more() -> None:
    made = specifications_by_sink(parse_specification(FLEET))
    assert list(made) == ['one_power', 'two_power', 'both']
    assert str(made['one_power']) == (
        'compunit power: float electrical_power((voltage: float, current: float));\n'
        'stream one = select voltage, current from "uav1/battery";\n'
        'stream one_power = electrical_power(one);\n'
        'sink one_power'
    )


def test_a_sink_uses_the_streams_of_those_before_it_by_name() -> None:
    made = specifications_by_sink(parse_specification(FLEET))
    assert str(made['both']) == 'stream both = merge(one_power, two_power);\nsink both'


def test_a_sink_keeps_its_messages() -> None:
    text = 'stream a = "/t";\nsink a as std_msgs/msg/Float64 (data = x) on "/out"'
    made = specifications_by_sink(parse_specification(f'{text}; stream b = a; sink b'))
    assert [str(each) for each in made.values()] == [text, 'stream b = a;\nsink b']


@pytest.mark.parametrize(
    ('text', 'message'),
    [
        ('stream a = "/t"', 'no stream is made; add a sink'),
        ('sink merge("/t", "/u")', 'a sink needs a name here'),
        ('sink a', 'a sink needs a name here'),
        ('stream a = "/t"; sink a; sink a', "a second sink 'a'; keep one"),
    ],
)
def test_what_has_no_name_is_refused(text: str, message: str) -> None:
    with pytest.raises(LanguageError, match=message):
        specifications_by_sink(parse_specification(text))
