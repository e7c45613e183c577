"""The formulas of the demonstration, read from a YAML file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dyknow_bringup.document import YamlEntry, read_document


@dataclass(frozen=True, slots=True)
class DescribedFormula:
    """A formula to monitor.

    Args:
        name: what it is called in scenarios and on the screen.
        formula: the text in the formula language.
        description: the same for people, a sentence.
    """

    name: str
    formula: str
    description: str


def load_formulas(path: Path) -> tuple[DescribedFormula, ...]:
    """The formulas of a YAML file, in its order.

    Raises:
        BringupError: for a file that is not such a list; the message names the key and the mend.
    """
    formulas: dict[str, DescribedFormula] = {}
    for entry in read_document(path).items():
        formula = _named_formula(entry)
        if formula.name in formulas:
            raise entry.error(f"the name '{formula.name}' is taken; give this formula another one")
        formulas[formula.name] = formula
    return tuple(formulas.values())


def _named_formula(entry: YamlEntry) -> DescribedFormula:
    texts = entry.record(('name', 'formula', 'description'))
    return DescribedFormula(**{key: ' '.join(text.text().split()) for key, text in texts.items()})
