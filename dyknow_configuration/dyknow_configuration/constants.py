"""The named constants of a robot.yaml, which all of its formulas may use."""

from __future__ import annotations

from dyknow_common import FORMULA_WORDS, LanguageError
from dyknow_configuration.documents.yaml_values import YamlValue
from dyknow_reasoning import Constants, parse_constants


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
