"""A formula with the name that its user gave it."""

from __future__ import annotations

from dataclasses import dataclass

from dyknow_reasoning.language.formula import Formula
from dyknow_reasoning.language.parsing import parse_formula
from dyknow_reasoning.language.type_checking import Kinds, check_types


@dataclass(frozen=True, slots=True)
class NamedFormula:
    """A formula of a group; its `str` is the canonical text.

    Args:
        name: what the user calls it.
        formula: its abstract syntax.
        kinds: the kinds of its features.
    """

    name: str
    formula: Formula
    kinds: Kinds

    def __str__(self) -> str:
        return str(self.formula)

    @classmethod
    def parsed(cls, name: str, text: str) -> NamedFormula:
        """The formula of a text.

        Raises:
            LanguageError: for a text that is no formula, or makes no sense; with the place.
        """
        formula = parse_formula(text)
        return cls(name, formula, check_types(formula, text))
