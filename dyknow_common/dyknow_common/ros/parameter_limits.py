"""Limits that are parameters of a node, and may change while it runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Final

from dyknow_common.errors import DyKnowError, ExitCode, amount
from dyknow_common.ros.node import DyKnowNode

_RANGE: Final = (1, 100_000_000)
"""The least and the greatest value of a limit that states no others."""


class ParameterLimits:
    """Parameters that limit what a node does; each is read when it is needed.

    Args:
        node: whose parameters are declared.
        parameters: the default and the description of each, and its range if it has one, by name.
        error: makes the error of a request that exceeds one.
    """

    def __init__(
        self,
        node: DyKnowNode,
        parameters: Mapping[str, tuple[int, str] | tuple[int, str, tuple[int, int]]],
        error: Callable[[str, ExitCode], DyKnowError],
    ) -> None:
        self._node = node.get_name()
        self._error = error
        self._values = {
            name: node.changing_parameter(name, default, text, *(stated or [_RANGE]))
            for name, (default, text, *stated) in parameters.items()
        }

    def __getitem__(self, parameter: str) -> int:
        """Return the present value of a parameter."""
        return int(self._values[parameter]())

    def check(
        self, parameter: str, count: int, what: str, code: ExitCode = ExitCode.UNAVAILABLE
    ) -> None:
        """Check a number against a limit.

        Args:
            parameter: the limit.
            count: the number that there would be.
            what: is counted.
            code: UNAVAILABLE if others count, too, and INVALID_ARGUMENT for one request alone.

        Raises:
            DyKnowError: if it exceeds the limit.
        """
        limit = self[parameter]
        if count > limit:
            others = 'try again when others have ended'
            mend = others if code is ExitCode.UNAVAILABLE else 'request less'
            raise self._error(
                f'there would be {amount(count)} {what}, more than {limit} (the limit '
                f"'{parameter}' of {self._node}); {mend}, or raise the parameter",
                code,
            )
