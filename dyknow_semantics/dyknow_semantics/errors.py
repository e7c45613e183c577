"""Errors of ontologies, annotations and matching."""

from __future__ import annotations

from dyknow_common import DyKnowError


class SemanticsError(DyKnowError):
    """An unknown name, or an ontology that contradicts itself or cannot be read."""
