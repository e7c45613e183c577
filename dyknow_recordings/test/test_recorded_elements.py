"""Elements of arrays that no message of a recording has."""

from __future__ import annotations

from pathlib import Path

from small_bags import messages, write

from dyknow_recordings import MessageTypes, observe_recording


def test_elements_that_no_message_has(tmp_path: Path) -> None:
    write(tmp_path / 'bag', 'mcap', 'none', messages(60))
    found = observe_recording(
        tmp_path / 'bag', MessageTypes(), lambda *_: ['ranges[2]', 'ranges[400]'], '/scan'
    )
    (scan,) = found
    assert list(scan.absent) == ['ranges[400]']
    assert 'not one at [400]' in scan.absent['ranges[400]']
    assert list(scan.values) == ['ranges[2]']
