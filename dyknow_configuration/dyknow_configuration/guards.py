"""The guards of a robot.yaml: which messages pass while which formulas hold.

guards:
  - name: cmd_vel_guard
    input: /cmd_vel_in
    output: /cmd_vel
    formulas:
      - distance                          # the name of a formula of the file
      - '"/cmd_vel_in".linear.x < 0.5'    # a formula over the messages
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from typing import Final

from dyknow_common import NANOSECONDS, DyKnowError, LanguageError, shortened, unknown
from dyknow_configuration.composed_text import ComposedText
from dyknow_configuration.robot import RequestedFormula, RequestedGuard
from dyknow_configuration.yaml_values import YamlValue
from dyknow_reasoning import (
    Constants,
    Feature,
    Formula,
    FormulaGroup,
    Quantifier,
    ReasoningError,
    Variable,
    check_trial,
    walk,
)

GUARD_KEYS: Final = (
    'name',
    'input',
    'output',
    'type',
    'formulas',
    'safe',
    'period',
    'latch',
    'timeout',
)
NOTHING: Final = 'nothing'
"""The value of `safe` with which a closed guard sends no message."""

_TOPICS: Final = ('input', 'output')
_REQUIRED: Final = ('name', 'input', 'output', 'formulas')
_NAME: Final = re.compile('[A-Za-z_][A-Za-z0-9_]*')
_TOPIC: Final = re.compile('/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*')
_TYPE: Final = re.compile('[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*')
_SHORTEST_NS: Final = 10 * NANOSECONDS['ms']
_LONGEST_NS: Final = NANOSECONDS['min']


def read_guards(
    value: YamlValue, formulas: Sequence[RequestedFormula], constants: Constants
) -> tuple[RequestedGuard, ...]:
    """Return the guards of a list.

    Args:
        value: the list.
        formulas: the formulas of the file, which guards may name.
        constants: the constants that the formulas of guards may name, too.

    Raises:
        ConfigurationError: with the place of the fault, also inside of a formula.
    """
    known = {each.name: each for each in formulas}
    names: dict[str, RequestedGuard] = {}
    for each in value.items('a list of guards'):
        stated = each.mapping(GUARD_KEYS, _REQUIRED)
        guard = _guard(each, stated, known, constants)
        if guard.name in names:
            raise stated['name'].error(f"the name '{guard.name}' is taken; use another")
        if conflict := guard.conflict_with(names.values()):
            raise stated['output'].error(conflict)
        names[guard.name] = guard
    return tuple(names.values())


def _guard(
    value: YamlValue,
    stated: Mapping[str, YamlValue],
    known: Mapping[str, RequestedFormula],
    constants: Constants,
) -> RequestedGuard:
    topic, output = (stated[key].matched(_TOPIC, 'the name of a topic') for key in _TOPICS)
    formulas: list[RequestedFormula] = []
    for each in stated['formulas'].one_or_more():
        formula = _formula(each, topic, known, constants)
        if formula in formulas:
            raise each.error(f"'{shortened(formula.name)}' is given twice; keep one")
        formulas.append(formula)
    if not formulas:
        raise stated['formulas'].error('a guard without formulas guards nothing; add one')
    return RequestedGuard(
        name=stated['name'].matched(_NAME, 'a name of letters, digits and _'),
        input=topic,
        output=output,
        formulas=tuple(formulas),
        message_type=(
            stated['type'].matched(_TYPE, 'a type such as geometry_msgs/msg/Twist')
            if 'type' in stated
            else ''
        ),
        safe=_safe(stated['safe']) if 'safe' in stated else {},
        place=value.place,
        **{key: _duration(stated[key]) for key in ('period', 'timeout') if key in stated},
        latch='latch' in stated and stated['latch'].truth(),
    )


def _duration(value: YamlValue) -> int:
    found = value.duration()
    if not _SHORTEST_NS <= found <= _LONGEST_NS:
        raise value.error('write a duration from 10 ms to 1 min')
    return found


def _safe(value: YamlValue) -> Mapping[str, object] | None:
    """Return the fields of the safe message; None for no message."""
    if value.is_text and value.text().strip() == NOTHING:
        return None
    value.entries(f"the fields of a message, or '{NOTHING}',")  # Raises errors of its keys.
    found: Mapping[str, object] = value.plain() or {}
    return found


def _formula(
    value: YamlValue, topic: str, known: Mapping[str, RequestedFormula], constants: Constants
) -> RequestedFormula:
    """Return a formula, given by its name or its text."""
    text = value.text('the name of a formula, or a formula').rstrip()
    name = value.line()
    if name in known:
        formula = known[name]
        try:
            _check(formula.text, topic, formula.constants)
        except DyKnowError as error:
            reason = error.reason if isinstance(error, LanguageError) else str(error)
            raise value.error(f"'{name}' cannot be a formula of a guard: {reason}") from None
        return formula
    if _NAME.fullmatch(name):
        raise value.error(unknown('formula', name, list(known)))
    try:
        with ComposedText().add_value(value).errors():
            _check(text, topic, constants)
    except ReasoningError as error:  # It has no place in the text.
        raise value.error(str(error)) from None
    return RequestedFormula(text, name, constants=constants)


def _check(text: str, topic: str, constants: Constants) -> None:
    """Check that a guard can ask a formula of each state, or of each message."""
    formula = RequestedFormula(text, constants=constants)
    if formula.reads(topic):
        _check_variables(check_trial(text, constants))
    else:
        FormulaGroup().add_formula('', text, constants, every_state=True)


def _check_variables(formula: Formula) -> None:
    """Refuse a variable that no feature has: no state of the guard would tell its objects."""
    nodes = list(walk(formula))
    arguments = {
        each.name
        for node in nodes
        if isinstance(node, Feature)
        for each in node.arguments
        if isinstance(each, Variable)
    }
    for node in nodes:
        if isinstance(node, Quantifier) and node.variable not in arguments:
            raise ReasoningError(
                f"no feature is about the variable '{node.variable}'; leave its quantifier out"
            )
