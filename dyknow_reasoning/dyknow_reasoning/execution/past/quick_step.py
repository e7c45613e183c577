"""Generated code that takes a state for all registers of a group.

It reads each field once, and has no effect if a value is not of the expected type. Operators over
intervals from 0 need a comparison of times; other registers are called.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import TypeAlias, cast

from dyknow_reasoning.execution.automata.readers import ReaderCode
from dyknow_reasoning.execution.past.machines import SinceMachine
from dyknow_reasoning.execution.past.registers import Register
from dyknow_reasoning.progression.atoms import Values
from dyknow_reasoning.progression.nodes import TRUE, Constant, Junction, Literal, Node

QuickStep: TypeAlias = Callable[[int, Values], Values | None]
"""Returns the values of a state with those of the registers; None if it had no effect."""


def quick_step(registers: Iterable[Register], *, in_place: bool = False) -> QuickStep:
    """Return the code for some registers; inner ones precede outer ones.

    Args:
        registers: the registers.
        in_place: True to add their fields to the values that the code is given.
    """
    source = ReaderCode()
    lines = [line for register in registers for line in _lines(register, source)]
    steps = '\n        '.join(lines)
    return cast(
        'QuickStep',
        source.run(
            f"""
def make():
    def step(time, values):
        try: {source.reads}
        except KeyError: return None
        if {source.unusual}: return None
        found = {'values' if in_place else 'dict(values)'}
        {steps}
        return found
    return step
"""
        ),
    )


def _lines(register: Register, source: ReaderCode) -> list[str]:
    """Return the statements that set the field of a register."""
    operands = register.operands
    left = _expression(operands.left, register, source)
    right = _expression(operands.right, register, source)
    machine = register.machine
    if left is None or right is None or machine is None:
        return [f'{source.name(register)}.update(time, found)']
    name, target = source.name(machine), f'found[{register.field!r}]'
    negation = 'not ' if register.is_negated else ''
    if not isinstance(machine, SinceMachine) or machine.start:
        return [f'{target} = {negation}{name}.step(time, {left}, {right})']
    reached = 'latest is not None'
    if machine.end is not None:
        reached += f' and time - latest <= {source.name(machine.end)}'
    clear = [] if operands.left is TRUE else [f'    if not {left}: {name}.latest = None']
    latest = 0 if machine.end is None else 'time'
    return [
        f'if {right}:',
        f'    {name}.latest = {latest}',
        f'    {target} = {not register.is_negated}',
        'else:',
        f'    latest = {name}.latest',
        *clear,
        f'    {target} = {negation}({reached})',
    ]


def _expression(node: Node, register: Register, source: ReaderCode) -> str | None:
    """Return the code of an operand; None if a predicate must evaluate an atom of it."""
    match node:
        case Constant(value=value):
            return str(value)
        case Literal(slot=slot, positive=positive):
            atom = source.atom(register.operands.atoms[slot], register.kinds)
            return atom and (f'({atom})' if positive else f'(not ({atom}))')
        case Junction(universal=universal, parts=parts):
            found = [_expression(part, register, source) for part in parts]
            texts = [text for text in found if text]
            joined = (' and ' if universal else ' or ').join(texts)
            return f'({joined})' if len(texts) == len(found) else None
        case _:  # pragma: no cover - operands have no windows
            return None
