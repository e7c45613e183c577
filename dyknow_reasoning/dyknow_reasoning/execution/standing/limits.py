"""Limits of the automata that open starts use, and of what remains of a formula."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from dyknow_reasoning.execution.automata.templates import Template
from dyknow_reasoning.execution.standing.open_starts import OpenStarts
from dyknow_reasoning.progression.residual import growth_error


def limit_automata(
    templates: Iterable[Template], starts: Sequence[OpenStarts], node_limit: int
) -> bool:
    """Limit the memory of automata that have grown; return True if one was forgotten.

    Args:
        templates: of all instances.
        starts: of all instances; the next state needs a step if their automaton was forgotten.
        node_limit: the most nodes of what remains of an instance.

    Raises:
        ReasoningError: if more remains of one.
    """
    is_forgotten = False
    for template in templates:
        automaton = template.automaton
        if not automaton.has_grown:
            continue
        automaton.has_grown = False
        if automaton.max_size > node_limit or automaton.is_full:
            used = [each for each in starts if each.template is template]
            for one in used:
                _check_size(one, node_limit)
            if automaton.is_full:
                is_forgotten = True
                automaton.forget({each for one in used for each in one.locations})
                for one in used:
                    one.forget()
    return is_forgotten


def _check_size(starts: OpenStarts, node_limit: int) -> None:
    """Check that what remains of an instance is not too large.

    Raises:
        ReasoningError: if it is.
    """
    largest = max((each.node for each in starts.locations), key=lambda node: node.size)
    if largest.size > node_limit:
        raise growth_error(largest.size, node_limit, largest, starts.instance.atoms)
