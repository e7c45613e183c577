"""Parameter files apply to nodes in any namespace."""

from __future__ import annotations

from pathlib import Path

import pytest

from dyknow_bringup.processes.arguments import for_any_namespace

OURS = ('stream_manager', 'stream_processing_engine_2', 'black_box_recorder', 'formula_monitor')
OTHERS = ('map_manager', 'ontology_server', 'lifecycle_manager', 'stream_recorder', 'base_guard')

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


def test_misspelt_names_are_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'parameters.yaml'
    path.write_text(
        'stream_reasoning_coordinatr:\n  ros__parameters: {silence_limit: 3.0}\n'
        '/**:\n  ros_parameters: {hang_limit: 3.0}\n'
        'controller_server:\n  ros__parameters: {frequency: 3.0}\n'
    )
    for_any_namespace(path)
    node, key = capsys.readouterr().err.split('warning: ')[1:]
    hint = "did you mean 'stream_reasoning_coordinator'?"
    assert node.startswith(f"{path}:1:1: unknown node 'stream_reasoning_coordinatr'; {hint}")
    assert key.startswith(f"{path}:4:3: unknown key 'ros_parameters'; did you mean 'ros__para")


def test_other_nodes_are_not_warned_of(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / 'parameters.yaml'
    path.write_text(''.join(f'{each}:\n  ros__parameters: {{a: 3.0}}\n' for each in OTHERS + OURS))
    for_any_namespace(path)
    assert capsys.readouterr() == ('', '')
