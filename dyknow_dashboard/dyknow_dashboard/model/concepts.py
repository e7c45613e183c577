"""The ontology and the annotations, for the page and for the completion of formulas."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from dyknow_semantics import Knowledge, Matcher
from dyknow_semantics.hierarchy import HierarchyEntry, hierarchy_entries

MAX_CONCEPTS: Final = 1000
"""The number of concepts that are shown."""

MAX_ANNOTATIONS: Final = 500
"""The number of annotations that are shown."""

MAX_OBJECTS: Final = 200
"""The number of objects of a sort that are shown."""


class ConceptTable:
    """The latest contents of the ontology manager and the stream semantics manager."""

    def __init__(self) -> None:
        self.version = 0
        self.knowledge: Knowledge | None = None
        self.fault = 'it has not been read yet'
        """Why the ontology is not known; empty if it is."""
        self.domains: dict[str, tuple[str, ...]] = {}
        """The objects of each sort."""
        self.units: dict[str, str] = {}
        """The units of the features that have one."""
        self._document: dict[str, Any] = {'sorts': [], 'features': [], 'annotations': []}

    def update(self, matcher: Matcher, annotations: Mapping[str, str]) -> None:
        """Take new contents.

        Args:
            matcher: of the ontologies and the valid annotations.
            annotations: all of them, with their faults.
        """
        self.knowledge, self.fault = matcher.knowledge, ''
        entries = hierarchy_entries(matcher)
        shown = entries[:MAX_CONCEPTS]
        knowledge = matcher.knowledge
        domains = {sort: knowledge.instances(sort) for sort in knowledge.sorts}
        if domains != self.domains:
            self.domains = domains
        self.units = {each.name: each.unit for each in knowledge.features if each.unit}
        self._document = {
            'sorts': [_sort(each, knowledge) for each in shown if each.kind == 'sort'],
            'features': [_concept(each) for each in shown if each.kind == 'feature'],
            'annotations': [
                {'text': text, 'fault': fault}
                for text, fault in list(annotations.items())[:MAX_ANNOTATIONS]
            ],
            'hidden': len(entries) - len(shown) + max(len(annotations) - MAX_ANNOTATIONS, 0),
        }
        self.version += 1

    def fail(self, fault: str) -> None:
        """Note why the contents cannot be read now; those read before remain."""
        if fault != self.fault:
            self.fault = fault
            self.version += 1

    def document(self) -> dict[str, Any]:
        """Return all sorts with their objects, features with their streams, and annotations."""
        return {**self._document, 'fault': self.fault}


def _concept(entry: HierarchyEntry) -> dict[str, Any]:
    return {
        'name': entry.name,
        'text': entry.text,
        'parents': list(entry.parents),
        'streams': list(entry.streams),
        'is_provided': entry.is_provided,
    }


def _sort(entry: HierarchyEntry, knowledge: Knowledge) -> dict[str, Any]:
    objects = knowledge.instances(entry.name)
    text = ' = '.join((entry.name, *entry.equivalents))
    shown = list(objects[:MAX_OBJECTS])
    return {**_concept(entry), 'text': text, 'objects': shown, 'count': len(objects)}
