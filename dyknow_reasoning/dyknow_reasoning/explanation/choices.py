"""The choices of objects that a verdict is about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from math import prod

from dyknow_reasoning.language.formula import Always, Exists, Forall, Formula
from dyknow_reasoning.progression.sizes import Counts


def objects_text(binding: Mapping[str, str]) -> str:
    """Return the text of a choice of objects: `u = uav1, v = uav2`."""
    return ', '.join(f'{variable} = {name}' for variable, name in binding.items())


def scope_text(formula: Formula, counts: Counts, binding: Mapping[str, str], *, holds: bool) -> str:
    """Return for which objects a formula is true or false, as the begin of its explanation.

    Args:
        formula: the formula.
        counts: the number of objects of each sort.
        binding: the choice of objects for the outermost `forall` that decided the formula.
        holds: the verdict.
    """
    every, some = _outermost(formula)
    objects = objects_text(binding)
    if holds and (all_choices := _choices(every, counts)):
        return f'for all {all_choices}, decided last for {objects}: '
    scope = f'for {objects}: ' if objects else ''
    if not holds and (no_choice := _choices(some, counts)):
        return f'{scope}for none of {no_choice}, decided last: '
    return scope


def _outermost(formula: Formula) -> tuple[list[Forall], list[Exists]]:
    """Return the outermost `forall`, and the outermost `exists` below them."""
    every: list[Forall] = []
    some: list[Exists] = []
    while True:
        match formula:
            case Always(body=Forall() as inner) if not some:
                # They commute: the choices are as for `forall x: always ...`.
                every.append(inner)
                formula = replace(formula, body=inner.body)
            case Forall() if not some:
                every.append(formula)
                formula = formula.body
            case Exists():
                some.append(formula)
                formula = formula.body
            case _:
                return every, some


def _choices(quantifiers: Sequence[Forall | Exists], counts: Counts) -> str:
    """Return the number of choices of objects for quantifiers; empty if there is only one."""
    count = prod(counts.get(each.sort, 1) for each in quantifiers)
    if count < 2:  # noqa: PLR2004 - one choice needs no number
        return ''
    if len(quantifiers) == 1:
        return f'{count} objects of {quantifiers[0].sort}'
    return (
        f'{count} choices of {", ".join(f"{each.variable} in {each.sort}" for each in quantifiers)}'
    )
