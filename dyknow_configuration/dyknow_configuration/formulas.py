"""The formulas of a robot.yaml, and files of formulas."""

from __future__ import annotations

import sys
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

from dyknow_common import FORMULA_WORDS, BlackBoxOptions, LanguageError, TextPosition, read_text
from dyknow_configuration.composed_text import ComposedText
from dyknow_configuration.errors import ConfigurationError
from dyknow_configuration.robot import RequestedFormula, Severity
from dyknow_configuration.triggers import (
    NO_TRIGGERS,
    FormulaTriggers,
    Triggers,
    read_events,
)
from dyknow_configuration.yaml_values import YamlValue, read_yaml
from dyknow_reasoning import (
    NO_CONSTANTS,
    Constants,
    check_types,
    notes_on,
    parse_constants,
    parse_formula,
)

FORMULA_KEYS: Final = (
    'name',
    'formula',
    'description',
    'severity',
    'every_state',
    'margin',
    'on',
    'record',
)

_YAML_ENDINGS: Final = frozenset({'.yaml', '.yml'})
_RECORD_KEYS: Final = ('topics', 'before', 'after')


def read_formulas(
    path: Path, constants: Constants = NO_CONSTANTS, *, is_checked: bool = False
) -> tuple[RequestedFormula, ...]:
    """Return the formulas of a file.

    A file with the ending `.yaml` or `.yml` has a list of formulas, as in `robot.yaml`. Any other
    file has one formula a line; # begins a comment line.

    Args:
        path: the path of the file.
        constants: the constants that the formulas may name.
        is_checked: True to check the formulas in lines, too.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    if path.suffix in _YAML_ENDINGS:
        return formulas_of([read_yaml(path)], constants)
    text = read_text(path, 'formulas', ConfigurationError)
    found: list[RequestedFormula] = []
    for position, formula in formula_lines(text):
        try:
            if is_checked:
                check_types(parse_formula(formula, constants), formula)
        except LanguageError as error:
            place = replace(position, column=position.column + error.position.column - 1)
            raise ConfigurationError.at(error.reason, path, text, place) from None
        found.append(RequestedFormula(formula, constants=constants))
    return tuple(found)


def formula_lines(text: str) -> Iterator[tuple[TextPosition, str]]:
    """Yield each formula of a text with one a line, and where it begins."""
    for number, line in enumerate(text.splitlines(), start=1):
        if (formula := line.strip()) and formula[0] != '#':
            yield TextPosition(number, line.index(formula) + 1), formula


def formulas_of(
    lists: Iterable[YamlValue],
    constants: Constants = NO_CONSTANTS,
    triggers: Triggers = NO_TRIGGERS,
    within: Collection[Path] = (),
) -> tuple[RequestedFormula, ...]:
    """Return formulas of lists of mappings, and of files that are named in their place.

    Args:
        lists: the lists of formulas.
        constants: the constants that the formulas may name.
        triggers: the triggers that the formulas may name.
        within: the files, resolved, that name the files of the lists.

    Raises:
        ConfigurationError: with the place of the fault, also inside of a formula.
    """
    found: list[RequestedFormula] = []
    names: set[str] = set()
    for each in (element for value in lists for element in _elements(value)):
        if each.is_mapping:
            added: Sequence[RequestedFormula] = [_formula(each, constants, triggers)]
        else:
            added = _formulas_in_file(each, constants, triggers, within)
        for formula in added:
            if formula.name and formula.name in names:
                place = each.mapping(FORMULA_KEYS)['name'] if each.is_mapping else each
                raise place.error(f"the name '{formula.name}' is taken; use another")
            names.add(formula.name)
        found += added
    return tuple(found)


def _formulas_in_file(
    value: YamlValue, constants: Constants, triggers: Triggers, within: Collection[Path]
) -> Sequence[RequestedFormula]:
    value.text('a mapping with name and formula, or a file of formulas')
    path = value.existing_file()
    if path.suffix not in _YAML_ENDINGS:
        return read_formulas(path, constants, is_checked=True)
    files = {*within, value.document.path.resolve()}
    if path.resolve() in files:
        raise value.error('this file names itself, or is named by one that it names; remove it')
    return formulas_of([read_yaml(path)], constants, triggers, files)


def _elements(value: YamlValue) -> list[YamlValue]:
    return [value] if value.is_text else value.items('a list of formulas')


def _formula(value: YamlValue, constants: Constants, triggers: Triggers) -> RequestedFormula:
    stated = value.mapping(FORMULA_KEYS, ('name', 'formula'))
    text = stated['formula'].text('a formula').rstrip()
    with ComposedText().add_value(stated['formula']).errors():
        check_types(parse_formula(text, constants), text)
    return RequestedFormula(
        text,
        stated['name'].line(),
        stated['description'].line() if 'description' in stated else '',
        Severity(
            stated['severity'].choice('severity', [*Severity])
            if 'severity' in stated
            else 'warning'
        ),
        constants,
        every_state='every_state' in stated and stated['every_state'].truth(),
        margin='margin' in stated and stated['margin'].truth(),
        on=_events(stated, triggers),
        record=_record(stated['record']) if 'record' in stated else None,
    )


def _events(stated: Mapping[str, YamlValue], triggers: Triggers) -> FormulaTriggers:
    if 'on' not in stated:
        return ()
    has_margin = 'margin' in stated and stated['margin'].truth()
    found = read_events(stated['on'], triggers)
    for _, trigger in found:
        if 'margin' in trigger.placeholders and not has_margin:
            needed = f"trigger '{trigger.name}' uses {{margin}}; add margin: true to the formula"
            raise stated['on'].error(needed)
    return found


def _record(value: YamlValue) -> BlackBoxOptions | None:
    """Return the black box that a formula asks for; None for `false`.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    if not (value.is_mapping or isinstance(value.plain(), bool)):
        raise value.expected('true, or a mapping with some of the keys topics, before, after,')
    if not value.is_mapping:
        return BlackBoxOptions() if value.truth() else None
    given: dict[str, Any] = {}
    for key, each in value.mapping(_RECORD_KEYS).items():
        if key == 'topics':
            read: Any = tuple(topic.text('the name of a topic') for topic in each.one_or_more())
        else:
            read = each.duration()
        given[key] = read
        # The fault is shown at its value.
        each.read(lambda _: BlackBoxOptions(**{key: read}), '')  # noqa: B023 - called at once
    return BlackBoxOptions(**given)


def read_constants(value: YamlValue) -> Constants:
    """Return the constants of a mapping from their names to values, such as `150 W`.

    Raises:
        ConfigurationError: with the place of the fault.
    """
    found: Constants = ()
    for key, each in value.entries('a mapping from names to values'):
        name, given = key.text(), each.plain()
        if name in FORMULA_WORDS:
            raise key.error(f"'{name}' cannot be the name of a constant; use another")
        if not isinstance(given, bool | int | float | str):
            raise each.expected('a number, or a text such as 150 W,')
        text = str(given).lower() if isinstance(given, bool) else str(given)
        try:
            found += parse_constants({name: text})
        except LanguageError as error:
            raise each.error(f"the constant '{name}': {error.reason}") from None
    return found


def warn_of_notes(formulas: Iterable[str]) -> None:
    """Print the notes on formulas as warnings; an incorrect formula has none."""
    for formula in formulas:
        with suppress(LanguageError):
            for note in notes_on(formula):
                print(f'warning: {note}', file=sys.stderr)  # noqa: T201 - of a command
