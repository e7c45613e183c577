"""The nodes of DyKnow import nothing that delays their start and that they do not use."""

import json
import subprocess
import sys

PROGRAM = """
import json, sys
import dyknow_bringup.ros.composition.dyknow_nodes
print(json.dumps(list(sys.modules)))
"""

UNUSED = {'dyknow_recordings', 'owlready2.sparql.parser', 'pint', 'rosbags'}


def test_nodes_import_what_they_use() -> None:
    done = subprocess.run([sys.executable, '-c', PROGRAM], check=True, stdout=subprocess.PIPE)
    assert not UNUSED & set(json.loads(done.stdout))
