"""What can go wrong with ontologies, annotations and matching."""

from __future__ import annotations

from dyknow_common import DyKnowError


class SemanticsError(DyKnowError):
    """A name that the ontology does not know, or knowledge that does not hold together."""
