"""Formulas of the demonstration, read from a YAML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dyknow_bringup.document import read_document


@dataclass(frozen=True, slots=True)
class DescribedFormula:
    """A formula to monitor.

    Args:
        name: its name in scenarios and on the screen.
        formula: the text in the formula language.
        description: the same for people, a sentence.
    """

    name: str
    formula: str
    description: str


def load_formulas(path: Path) -> tuple[DescribedFormula, ...]:
    """Return the formulas of a YAML file, in its order.

    Raises:
        BringupError: if the file is not such a list; the message names the key and the correction.
    """
    formulas: dict[str, DescribedFormula] = {}
    for entry in read_document(path).items():
        texts = entry.record(('name', 'formula', 'description'))
        formula = DescribedFormula(
            **{key: ' '.join(each.text().split()) for key, each in texts.items()}
        )
        if formula.name in formulas:
            raise entry.error(f"the name '{formula.name}' is taken; give this formula another one")
        formulas[formula.name] = formula
    return tuple(formulas.values())
