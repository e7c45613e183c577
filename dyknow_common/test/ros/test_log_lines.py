"""The log lines of nodes, and their rate."""

import pytest

from dyknow_common.ros import LogOnce, throttle
from dyknow_common.ros.node import loaded_text


def test_each_cause_is_logged_once(monkeypatch: pytest.MonkeyPatch) -> None:
    log = LogOnce()
    assert log.new(['a', 'b', 'a']) == ['a', 'b']
    assert log.new(['b', 'c']) == ['c']
    assert log.new(['a']) == []
    monkeypatch.setattr(throttle, 'FORGET_NS', 0)
    assert log.new([]) == []
    assert log.new(['a']) == ['a']


def test_loaded_things_are_counted() -> None:
    assert loaded_text({'streams': 3, 'files': 1}) == '3 streams from 1 file'
    assert loaded_text({'concepts': 1, 'objects': 0}) == '1 concept, 0 objects'
