"""What reaches below rclpy fits the installed ROS, and DyKnow works without it."""

from __future__ import annotations

import shutil
import subprocess
from ctypes import sizeof
from pathlib import Path

import pytest
from ament_index_python.packages import get_package_prefix
from dyknow_interfaces.msg import FormulaResult

from dyknow_common.executables import FAULT
from dyknow_common.ros.below_rclpy import senders, versions
from node_processes import end_of, node_that
from system import ALWAYS, LIMIT, SOON, System, private_environment

SIZES = """
#include <stddef.h>
#include <stdio.h>
#include <rcutils/types/uint8_array.h>
#include <rmw/types.h>
int main(void) {
  printf("%zu %zu %zu", sizeof(rmw_message_info_t), sizeof(rcutils_uint8_array_t),
    offsetof(rmw_message_info_t, publisher_gid.data));
}
"""


@pytest.mark.skipif(shutil.which('cc') is None, reason='there is no C compiler')
def test_structures_are_those_of_the_headers(tmp_path: Path) -> None:
    source, program = tmp_path / 'sizes.c', tmp_path / 'sizes'
    source.write_text(SIZES)
    folders = [
        f'-I{get_package_prefix(each)}/include{inner}'
        for each in ('rcutils', 'rmw', 'rosidl_runtime_c', 'rosidl_typesupport_interface')
        for inner in ('', f'/{each}')
    ]
    subprocess.run(['cc', *folders, str(source), '-o', str(program)], check=True)
    found = subprocess.run([str(program)], capture_output=True, text=True, check=True).stdout
    mirrored = senders._Info
    assert [int(each) for each in found.split()] == [
        sizeof(mirrored),
        sizeof(senders._Bytes),
        mirrored.publisher_gid.offset,
    ]


@pytest.mark.parametrize('expected', ['6.1', '7.30', '7', ''])
def test_other_versions_are_not_mirrored(expected: str, monkeypatch: pytest.MonkeyPatch) -> None:
    assert senders._Takers().taker is not None
    monkeypatch.setitem(senders._VERSIONS, 'rmw', expected)
    assert senders._Takers().taker is None


def test_identifiers_of_other_middlewares_are_not_those_of_the_graph(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(senders, 'get_rmw_implementation_identifier', lambda: 'rmw_cyclonedds_cpp')
    assert senders._Takers().taker is None


def test_a_package_that_is_not_installed_has_no_version() -> None:
    assert not versions.has_versions({'no_such_package': '1.0'})


@pytest.mark.parametrize('composition', [True, False], ids=['one process', 'processes'])
def test_a_system_without_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, *, composition: bool
) -> None:
    monkeypatch.setenv(versions.SWITCH, 'off')
    with System(tmp_path, composition=composition) as system:
        system.batteries.reset()
        assert system.evaluate(SOON).verdict == FormulaResult.TRUE
        future = system.ask(ALWAYS, timeout=60.0)
        system.wait_until_running(future)
        system.batteries.power['uav2'] = 240.0
        system.decided(future, FormulaResult.FALSE)


def test_a_node_that_hangs_without_it() -> None:
    environment = {**private_environment(), versions.SWITCH: 'off'}
    arguments = ('-p', 'hang_limit:=1.0')
    with node_that('threading.Event().wait()', *arguments, environment=environment) as process:
        code, errors = end_of(process, LIMIT)
    assert code == FAULT, errors
    assert 'has hung for' in errors
