"""The nodes of DyKnow import nothing that delays their start and that they do not use."""

import json
import subprocess
import sys

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
    done = subprocess.run([sys.executable, '-c', PROGRAM], check=True, stdout=subprocess.PIPE)
    imported = set(json.loads(done.stdout))
    assert 'dyknow_coordinator' in imported
    assert not UNUSED & imported
