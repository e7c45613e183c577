"""Words that the languages reserve, which no concept and no object may be named."""

from __future__ import annotations

from typing import Final

FORMULA_WORDS: Final = frozenset(
    {'true', 'false', 'not', 'and', 'or', 'forall', 'exists', 'in', 'always', 'eventually'}
    | {'until', 'U'}
)
"""The reserved words of formulas; a test compares them with the grammar."""

SSL_WORDS: Final = frozenset({'for', 'where', 'with', 'contains'})
"""The reserved words of annotations; a test compares them with the grammar."""

FUNCTIONS: Final = frozenset({'abs', 'max', 'maximum', 'mean', 'min', 'minimum', 'sqrt', 'sum'})
"""Names of functions, which no feature and no stream may have."""
