"""Parameter files apply to nodes in any namespace."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_bringup.processes.arguments import for_any_namespace

NAV2 = """\
stream_manager:
  ros__parameters:
    hang_limit: 1e-3  # a number for ROS, a text for YAML 1.1
"stream_reasoning_coordinator":  # quoted

  # a comment
  ros__parameters:
    nested:
      ros__parameters_of_a_name: 1
"""


def test_names_without_a_namespace_are_those_in_any(tmp_path: Path) -> None:
    path = tmp_path / 'parameters.yaml'
    path.write_text(NAV2)
    changed = for_any_namespace(path)
    assert changed.name == path.name
    assert path.read_text() == NAV2
    assert changed.read_text() == NAV2.replace('stream_manager:', '/**/stream_manager:').replace(
        '"stream_reasoning_coordinator":', '/**/stream_reasoning_coordinator:'
    )


@pytest.mark.parametrize(
    'text',
    [
        '/**:\n  ros__parameters:\n    hang_limit: 2.0\n',
        '/robot1/stream_manager:\n  ros__parameters: {hang_limit: 2.0}\n',
        'robot1:\n  stream_manager:\n    ros__parameters: {hang_limit: 2.0}\n',
        '',
        '[not a mapping',
    ],
)
def test_other_files_remain(text: str, tmp_path: Path) -> None:
    path = tmp_path / 'parameters.yaml'
    path.write_text(text)
    assert for_any_namespace(path) == path


def test_files_that_cannot_be_read_remain(tmp_path: Path) -> None:
    assert for_any_namespace(tmp_path / 'none.yaml') == tmp_path / 'none.yaml'
    assert for_any_namespace(tmp_path) == tmp_path
    (tmp_path / 'binary.yaml').write_bytes(b'\xff\xfe')
    assert for_any_namespace(tmp_path / 'binary.yaml') == tmp_path / 'binary.yaml'
