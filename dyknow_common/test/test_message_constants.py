"""Constants of message types, from `.msg` files."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_common import DyKnowError, constant_names, message_constant, message_constants
from dyknow_common.message_constants import constants_in

DEFINITION = """
# uint8 COMMENTED=1
uint8 STATUS_UNKNOWN   = 0   # Nothing is known.
int8 STATUS_ABORTED=-6
uint8 MASK = 0x0F
float32 LIMIT=2.5
bool ON=true
string<=9 NAME = "it is # 1"
string WORD=plain
char DAMAGED=x
uint8 status 3
builtin_interfaces/Time stamp
"""


@pytest.fixture(autouse=True)
def _workspace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for package, text in (
        ('a_msgs', DEFINITION),
        ('b_msgs', 'uint8 STATUS_UNKNOWN=0\nuint8 MASK=1\n'),
    ):
        folder = tmp_path / 'share' / package / 'msg'
        folder.mkdir(parents=True)
        (folder / 'GoalState.msg').write_text(text)
    monkeypatch.setenv('AMENT_PREFIX_PATH', f'{tmp_path}/none:{tmp_path}')
    _forget()
    yield
    _forget()


def _forget() -> None:
    for function in ('_installed', '_installed_names'):
        getattr(message_constants, function).cache_clear()


def test_definitions() -> None:
    assert constants_in(DEFINITION) == {
        'STATUS_UNKNOWN': 0,
        'STATUS_ABORTED': -6,
        'MASK': 15,
        'LIMIT': 2.5,
        'ON': True,
        'NAME': 'it is # 1',
        'WORD': 'plain',
    }


@pytest.mark.parametrize(
    ('name', 'value'),
    [
        ('a_msgs/msg/GoalState.STATUS_ABORTED', -6),
        ('GoalState.STATUS_UNKNOWN', 0),
        ('b_msgs/msg/GoalState.MASK', 1),
        ('GoalState.status', None),
        ('goals.STATUS_ABORTED', None),
        ('Other.STATUS_ABORTED', None),
        ('c_msgs/msg/Other.LIMIT', None),
        (f'{"Long" * 100}.LIMIT', None),
    ],
)
def test_values(name: str, value: int | None) -> None:
    assert message_constant(name) == value


@pytest.mark.parametrize(
    ('name', 'message'),
    [
        (
            'GoalState.STATUS_ABORTD',
            "b_msgs/msg/GoalState have no constant 'STATUS_ABORTD'; did you mean 'STATUS_ABORTED'?",
        ),
        (
            'GoalState.MASK',
            'write one of a_msgs/msg/GoalState.MASK, b_msgs/msg/GoalState.MASK',
        ),
        (
            'GoalStat.LIMIT',
            "there is no message type 'GoalStat'; did you mean 'GoalState.LIMIT'?",
        ),
        (
            'c_msgs/msg/GoalState.LIMIT',
            "there is no message type 'c_msgs/msg/GoalState'; did you mean 'GoalState.LIMIT'?",
        ),
        (
            'GoalState.STATUS_ABORTED',
            'is no constant of b_msgs/msg/GoalState; write a_msgs/msg/GoalState.STATUS_ABORTED if',
        ),
        ('b_msgs/msg/GoalState.X', 'there is STATUS_UNKNOWN, MASK'),
    ],
)
def test_misspelt_names(name: str, message: str) -> None:
    with pytest.raises(DyKnowError) as error:
        message_constant(name)
    assert message in str(error.value)


def test_given_types() -> None:
    types = {'a_msgs/msg/GoalState': {'LIMIT': 9.5}}
    assert message_constant('GoalState.LIMIT', types) == 9.5
    assert message_constant('GoalStates.LIMIT', types) is None


def test_names_in_texts() -> None:
    text = 'x = GoalState.ON and y = "Is.THIS" or "/A".B = a_msgs/msg/GoalState.ON'
    assert constant_names(text) == ['GoalState.ON', 'a_msgs/msg/GoalState.ON']
