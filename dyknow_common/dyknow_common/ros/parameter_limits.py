"""Limits that are parameters of a node, and may change while it runs."""

from __future__ import annotations

from collections.abc import Mapping

from dyknow_common.ros.node import DyKnowNode


class ParameterLimits:
    """Parameters that limit what a node does; each is read when it is needed.

    Args:
        node: whose parameters are declared.
        parameters: the default and the description of each, by name.
        most: the greatest value of each.
    """

    def __init__(
        self, node: DyKnowNode, parameters: Mapping[str, tuple[int, str]], most: int
    ) -> None:
        self._values = {
            name: node.changing_parameter(name, *rest, (1, most))
            for name, rest in parameters.items()
        }

    def __getitem__(self, parameter: str) -> int:
        """Return the present value of a parameter."""
        return int(self._values[parameter]())
