"""Objects in place of variables, in formulas and terms whose texts are used.

Comparisons with equal texts share their values, so the text of a ground term must tell its objects
from the variables that it binds. For `k = a`, the text of `max(X[a] - X[k] for a in S)` is
`max(X[a_2] - X[a] for a_2 in S)`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeAlias

from dyknow_common import unused_name
from dyknow_reasoning.language.formula import walk, with_changed_parts
from dyknow_reasoning.language.spatial import Spatial
from dyknow_reasoning.language.terms import Object, Quantifier, Variable

Binding: TypeAlias = Mapping[str, str]
"""The object of each variable."""


def with_objects(node: Any, binding: Binding) -> Any:
    """Return a formula or a term with objects in place of its bound variables, for its text.

    An inner variable with the name of such an object has another name in the text.
    """
    if isinstance(node, Variable) and node.name in binding:
        return Object(binding[node.name])
    if isinstance(node, Quantifier) and node.variable in binding.values():
        node = _apart_from_objects(node, binding)
    return with_changed_parts(node, lambda part: with_objects(part, binding))


def _apart_from_objects(node: Quantifier, binding: Binding) -> Quantifier:
    """Rename the variable of a quantifier if an object in its body will have the same name."""
    shown: Any = node
    nodes = list(walk(shown))
    variables = {each.name for each in nodes if isinstance(each, Variable)}
    objects = {binding[each] for each in variables & binding.keys()}
    if node.variable not in objects:
        return node
    taken = variables | objects | {each.name for each in nodes if isinstance(each, Object)}
    taken |= {each.variable for each in nodes if isinstance(each, Quantifier)}
    found: Quantifier = _renamed(node, node.variable, unused_name(node.variable, taken))
    return found


def _renamed(node: Any, variable: str, new: str) -> Any:
    node = with_changed_parts(node, lambda part: _renamed(part, variable, new))
    if isinstance(node, Variable) and node.name == variable:
        return replace(node, name=new)
    if isinstance(node, Quantifier) and node.variable == variable:
        return replace(node, variable=new)
    if isinstance(node, Spatial) and node.place == variable:
        return replace(node, place=new)
    return node
