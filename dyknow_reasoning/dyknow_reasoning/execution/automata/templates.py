"""Templates: the parts that instances share if they differ only in their fields and constants."""

from __future__ import annotations

from collections.abc import Iterable
from math import inf

from dyknow_reasoning.execution.automata.automaton import Automaton, Location
from dyknow_reasoning.execution.automata.configurations import Configurations
from dyknow_reasoning.progression.nodes import Node, Window, descendants, operands


class Template:
    """The automaton of some instances, of one formula or of several."""

    def __init__(self, formula: Node) -> None:
        self.automaton = Automaton(formula)
        self.configurations = Configurations(self.automaton)
        # False once there were too many configurations.
        self.uses_configurations = True
        # True if a window without an end may open after the first state.
        self.opens_windows_later = _nests_unbounded_window(formula)
        # The most nodes of an instance for which the node limit need not be checked.
        self.safe_size: float = inf

    @property
    def is_full(self) -> bool:
        """True if `forget` should be called."""
        return self.automaton.is_full or self.configurations.is_full

    @property
    def is_large(self) -> bool:
        """True if an instance may be larger than `safe_size`."""
        return self.automaton.max_size > self.safe_size

    @property
    def needs_attention(self) -> bool:
        """True if it has grown, and a limit is to be checked before the next state."""
        return self.automaton.has_grown and (self.is_full or self.is_large)

    def forget(self, locations: Iterable[Location]) -> None:
        """Drop all configurations, and the automaton but for some locations if it is full."""
        self.uses_configurations &= not self.configurations.are_too_many
        self.configurations.forget()
        if self.automaton.is_full:
            self.automaton.forget(locations)


def _nests_unbounded_window(formula: Node) -> bool:
    found = descendants([formula])
    inner = descendants(side for each in found for side in operands(each))
    return any(type(each) is Window and each.end is None for each in inner)
