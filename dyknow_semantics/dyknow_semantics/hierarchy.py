"""The hierarchies of sorts and features, with the streams that carry each feature.

`dyknow_semantics` itself does not import this module, as rich is slow to import.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Final

from rich.markup import escape
from rich.tree import Tree

from dyknow_semantics.matching.matching import Matcher
from dyknow_semantics.matching.near_misses import Explanation
from dyknow_semantics.ontology.features import FeatureSignature
from dyknow_semantics.ontology.knowledge import Knowledge

_ROOTS: Final = {'sort': '(sorts)', 'feature': '(features)'}
"""The names of the roots; they are not valid names of concepts."""

_MAX_OBJECTS: Final = 8
"""The number of objects of a sort that are shown by name."""


@dataclass(frozen=True, slots=True)
class HierarchyEntry:
    """A concept with its equivalent concepts.

    Args:
        kind: `sort` or `feature`.
        name: the first of the equivalent names.
        parents: the concepts directly above.
        text: the text on the terminal.
        is_provided: True for a sort, and for a feature if a stream carries it or one below it.
    """

    kind: str
    name: str
    equivalents: tuple[str, ...]
    parents: tuple[str, ...]
    text: str
    streams: tuple[str, ...] = ()
    is_provided: bool = True


def hierarchy_entries(matcher: Matcher) -> tuple[HierarchyEntry, ...]:
    """Return all sorts and features, by name."""
    knowledge = matcher.knowledge
    features = {each.name: each for each in knowledge.features}
    equivalents = {name: _equivalents(name, knowledge) for name in {*knowledge.sorts, *features}}
    kept = sorted(name for name, names in equivalents.items() if name == names[0])
    above = {
        name: {*knowledge.superconcepts(name)}.difference(knowledge.subconcepts(name)) & {*kept}
        for name in kept
    }
    carriers: dict[str, list[str]] = defaultdict(list)
    for carrier in matcher.index:
        carriers[carrier.pattern.feature].append(str(carrier))
    return tuple(
        _entry(
            equivalents[name],
            # A parent lies above no other concept above.
            tuple(sorted(above[name].difference(*(above[each] for each in above[name])))),
            carriers,
            features.get(name),
            knowledge,
        )
        for name in kept
    )


def hierarchy_tree(found: Iterable[HierarchyEntry]) -> Tree:
    """Return concepts as trees; a concept with several parents is shown in full only once."""
    by_parent: dict[str, list[HierarchyEntry]] = defaultdict(list)
    for entry in found:
        for parent in entry.parents or (_ROOTS[entry.kind],):
            by_parent[parent].append(entry)
    tree = Tree('concepts')
    for root in _ROOTS.values():
        _grow(tree.add(root), root, by_parent, set())
    return tree


def explanation_tree(concept: str, found: Sequence[Explanation]) -> Tree:
    """Return the matches and the near misses of a concept as a tree."""
    tree = Tree(escape(concept))
    for title, matches in (('matches', True), ('does not match', False)):
        explanations = [each for each in found if each.matches is matches]
        branch = tree.add(title if explanations else f'[dim]{title}: none[/dim]')
        for each in explanations:
            branch.add(escape(each.stream)).add(escape(each.reason))
    return tree


def _equivalents(name: str, knowledge: Knowledge) -> list[str]:
    """Return a concept and its equivalent concepts, sorted."""
    return [each for each in knowledge.subconcepts(name) if name in knowledge.subconcepts(each)]


def _entry(
    names: Sequence[str],
    parents: tuple[str, ...],
    carriers: Mapping[str, list[str]],
    feature: FeatureSignature | None,
    knowledge: Knowledge,
) -> HierarchyEntry:
    name, *others = names
    text = ' = '.join(names)
    if feature is None:
        text += _objects(name, knowledge)
        return HierarchyEntry('sort', name, tuple(others), parents, text)
    arguments = f'[{", ".join(feature.argument_sorts)}]' if feature.argument_sorts else ''
    unit = f' in {feature.unit}' if feature.unit else ''
    text += f'{arguments}: {feature.value_type}{unit}'
    streams = tuple(sorted(stream for each in names for stream in carriers.get(each, ())))
    is_provided = any(each in carriers for each in knowledge.subconcepts(name))
    return HierarchyEntry('feature', name, tuple(others), parents, text, streams, is_provided)


def _objects(sort: str, knowledge: Knowledge) -> str:
    objects = knowledge.instances(sort)
    if not objects:
        return ''
    more = f', ... ({len(objects)})' if len(objects) > _MAX_OBJECTS else ''
    return f': {", ".join(objects[:_MAX_OBJECTS])}{more}'


def _grow(
    tree: Tree, name: str, by_parent: Mapping[str, list[HierarchyEntry]], shown: set[str]
) -> None:
    """Add the concepts below a concept to its tree."""
    for entry in by_parent.get(name, ()):
        text = escape(entry.text)
        branch = tree.add(text if entry.is_provided else f'[yellow]{text} (no stream)[/yellow]')
        if entry.name in shown:
            if entry.name in by_parent:
                branch.add('[dim]as above[/dim]')
            continue
        shown.add(entry.name)
        for stream in entry.streams:
            branch.add(f'[green]{escape(stream)}[/green]')
        _grow(branch, entry.name, by_parent, shown)
