"""Files of ROS parameters, as users of Nav2 write them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from dyknow_bringup.errors import BringupError
from dyknow_bringup.processes.robot import temporary_folder
from dyknow_common import read_text

_NODE: Final = re.compile(
    r"""^(?P<quote>["']?)(?P<name>\w+)(?P=quote):(?=[ \t]*(?:\#[^\n]*)?\n"""
    r"""(?:[ \t]*(?:\#[^\n]*)?\n)*[ \t]+ros__parameters:)""",
    re.MULTILINE,
)
"""The name of a node without a namespace, with its parameters below it."""


def for_any_namespace(path: Path) -> Path:
    """Return a file of parameters for the nodes in any namespace.

    ROS takes `stream_manager:` for the node in the root namespace, and ignores it for others.

    Args:
        path: of a file; where its names have a namespace or a wildcard, they remain.
    """
    try:
        text = read_text(path, 'parameters', BringupError)
    except BringupError:
        return path  # Checks of the configuration, or the nodes, say what is wrong with it.
    changed = _NODE.sub(r'/**/\g<name>:', text)
    if changed == text:
        return path
    copy = temporary_folder() / path.name
    copy.write_text(changed, encoding='utf-8')
    return copy
