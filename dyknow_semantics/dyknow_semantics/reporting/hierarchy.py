"""The hierarchies of sorts and of features, with the streams that carry each, to be looked at."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Final

from rich.markup import escape
from rich.tree import Tree

from dyknow_semantics.matching.matching import Matcher
from dyknow_semantics.matching.near_misses import Explanation
from dyknow_semantics.ontology.features import FeatureSignature
from dyknow_semantics.ontology.knowledge import Knowledge

_ROOTS: Final = {'sort': '(sorts)', 'feature': '(features)'}
"""What stands above those that have none above; no concept has such a name."""

_SHOWN: Final = 8
"""So many objects of a sort are shown by name."""


@dataclass(frozen=True, slots=True)
class HierarchyEntry:
    """A concept and all that are equivalent to it.

    Args:
        kind: `sort` or `feature`.
        name: the first of their names.
        equivalents: the other ones.
        parents: those that lie directly above it.
        text: how it is shown.
        streams: what carries it, for a feature.
        is_provided: whether a stream carries it or anything below it; so is every sort.
    """

    kind: str
    name: str
    equivalents: tuple[str, ...]
    parents: tuple[str, ...]
    text: str
    streams: tuple[str, ...] = ()
    is_provided: bool = True


def entries(matcher: Matcher) -> tuple[HierarchyEntry, ...]:
    """All sorts and features, by name."""
    knowledge = matcher.knowledge
    features = {each.name: each for each in knowledge.features}
    names = sorted({*knowledge.sorts, *features})
    kept = [name for name in names if name == _first(name, knowledge)]
    above = {name: _strictly_above(name, knowledge) & set(kept) for name in kept}
    carriers: dict[str, list[str]] = defaultdict(list)
    for offer in matcher.index:
        carriers[offer.pattern.feature].append(str(offer))
    return tuple(
        _entry(name, _lowest(above[name], above), carriers, features.get(name), knowledge)
        for name in kept
    )


def as_tree(found: Iterable[HierarchyEntry]) -> Tree:
    """Concepts as trees; what lies below several others is shown in full below the first."""
    by_parent: dict[str, list[HierarchyEntry]] = defaultdict(list)
    for entry in found:
        for parent in entry.parents or (_ROOTS[entry.kind],):
            by_parent[parent].append(entry)
    tree = Tree('concepts')
    for root in _ROOTS.values():
        _grow(tree.add(root), root, by_parent, set())
    return tree


def as_json(found: Iterable[HierarchyEntry]) -> list[dict[str, Any]]:
    """Concepts as JSON has them."""
    return [asdict(entry) for entry in found]


def explanation_tree(concept: str, found: Sequence[Explanation]) -> Tree:
    """Why streams match a concept, and why others nearly do."""
    tree = Tree(escape(concept))
    for title, matches in (('matches', True), ('does not match', False)):
        those = [each for each in found if each.matches is matches]
        branch = tree.add(title if those else f'[dim]{title}: none[/dim]')
        for each in those:
            branch.add(escape(each.stream)).add(escape(each.reason))
    return tree


def _entry(
    name: str,
    parents: Iterable[str],
    carriers: Mapping[str, list[str]],
    feature: FeatureSignature | None,
    knowledge: Knowledge,
) -> HierarchyEntry:
    below = knowledge.subconcepts(name)
    same = tuple(each for each in below if name in knowledge.subconcepts(each))
    others = tuple(each for each in same if each != name)
    text = ' = '.join([name, *others])
    if feature is None:
        return HierarchyEntry(
            'sort', name, others, tuple(sorted(parents)), text + _objects(name, knowledge)
        )
    streams = tuple(sorted(stream for each in same for stream in carriers.get(each, ())))
    provided = any(each in carriers for each in below)
    text += _signature(feature)
    return HierarchyEntry('feature', name, others, tuple(sorted(parents)), text, streams, provided)


def _signature(feature: FeatureSignature) -> str:
    arguments = f'[{", ".join(feature.argument_sorts)}]' if feature.argument_sorts else ''
    unit = f' in {feature.unit}' if feature.unit else ''
    return f'{arguments}: {feature.value_type}{unit}'


def _objects(sort: str, knowledge: Knowledge) -> str:
    objects = knowledge.instances(sort)
    if not objects:
        return ''
    more = f', ... ({len(objects)})' if len(objects) > _SHOWN else ''
    return f': {", ".join(objects[:_SHOWN])}{more}'


def _first(name: str, knowledge: Knowledge) -> str:
    return min(each for each in knowledge.subconcepts(name) if name in knowledge.subconcepts(each))


def _strictly_above(name: str, knowledge: Knowledge) -> set[str]:
    return set(knowledge.superconcepts(name)) - set(knowledge.subconcepts(name))


def _lowest(concepts: set[str], above: Mapping[str, set[str]]) -> set[str]:
    """Those that lie above no other one."""
    return concepts - set[str]().union(*(above[each] for each in concepts))


def _grow(
    tree: Tree, name: str, by_parent: Mapping[str, list[HierarchyEntry]], shown: set[str]
) -> None:
    for entry in by_parent.get(name, ()):
        branch = tree.add(_label(entry))
        if entry.name in shown:
            if entry.name in by_parent:
                branch.add('[dim]as above[/dim]')
            continue
        shown.add(entry.name)
        for stream in entry.streams:
            branch.add(f'[green]{escape(stream)}[/green]')
        _grow(branch, entry.name, by_parent, shown)


def _label(entry: HierarchyEntry) -> str:
    text = escape(entry.text)
    return text if entry.is_provided else f'[yellow]{text} (no stream)[/yellow]'
