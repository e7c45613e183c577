"""The start of ROS leaves the user's settings of the middleware alone."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
import rclpy

from dyknow_common.ros import start_ros

PROFILE = 'FASTRTPS_DEFAULT_PROFILES_FILE'


@pytest.fixture(autouse=True)
def folder(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Path:
    for name in (PROFILE, 'ROS_SECURITY_ENABLE'):
        monkeypatch.setenv(name, '')  # It is restored also if the test sets it itself.
        monkeypatch.delenv(name)
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', 'OFF')
    monkeypatch.chdir(tmp_path)
    return tmp_path


def profile_after_start() -> str | None:
    start_ros([])
    rclpy.try_shutdown()
    return os.environ.get(PROFILE)


def test_a_process_has_the_profile_of_dyknow() -> None:
    profile = profile_after_start()
    assert profile is not None
    assert '<throughputController>' in Path(profile).read_text(encoding='utf-8')


def test_the_profile_of_the_user_stays(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(PROFILE, 'mine.xml')
    assert profile_after_start() == 'mine.xml'


def test_the_profile_in_the_folder_stays(folder: Path) -> None:
    (folder / 'DEFAULT_FASTRTPS_PROFILES.xml').touch()
    assert profile_after_start() is None


def test_secure_processes_have_no_profile(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_SECURITY_ENABLE', 'true')
    assert profile_after_start() is None
