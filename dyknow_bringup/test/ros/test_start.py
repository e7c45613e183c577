"""The start of the nodes of DyKnow."""

import json
import subprocess
import sys

import pytest

from dyknow_bringup.ros.system_start import SystemStart

PROGRAM = """
import json, sys
from pkgutil import resolve_name
from dyknow_bringup.ros.composition.dyknow_nodes import NODES
for path in NODES:
    resolve_name(path)
print(json.dumps(list(sys.modules)))
"""

UNUSED = {'dyknow_recordings', 'owlready2.sparql.parser', 'pint', 'rosbags'}


def test_nodes_import_what_they_use() -> None:
    """They import nothing that delays their start and that they do not use."""
    done = subprocess.run([sys.executable, '-c', PROGRAM], check=True, stdout=subprocess.PIPE)
    imported = set(json.loads(done.stdout))
    assert 'dyknow_coordinator' in imported
    assert not UNUSED & imported


@pytest.mark.parametrize('discovery', ['OFF', 'LOCALHOST'])
def test_the_variable_that_hides_all_nodes(discovery: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv('ROS_AUTOMATIC_DISCOVERY_RANGE', discovery)
    found = str(SystemStart('/', ['stream_manager']))
    assert 'no status of stream_manager' in found
    assert ('ROS_AUTOMATIC_DISCOVERY_RANGE=OFF' in found) is (discovery == 'OFF')
