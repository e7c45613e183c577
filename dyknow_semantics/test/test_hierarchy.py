"""Hierarchies and explanations on a terminal and as JSON."""

from __future__ import annotations

from dataclasses import asdict

from annotated import matcher_of
from hypothesis import given
from hypothesis import strategies as st
from rich.console import Console
from rich.tree import Tree

from dyknow_semantics import (
    Knowledge,
    Matcher,
    parse_annotations,
    parse_concept,
)
from dyknow_semantics.hierarchy import (
    explanation_tree,
    hierarchy_entries,
    hierarchy_tree,
)

SSL = """
    stream a contains Altitude[uav1] = z [ft];
    stream b contains BarometricAltitude[u] = z for every u in UAV where u = id;
    stream c contains Power[rover] = p;
"""


def text_of(tree: Tree) -> str:
    console = Console(width=200, highlight=False)
    with console.capture() as capture:
        console.print(tree)
    return '\n'.join(line.rstrip() for line in capture.get().splitlines())


def test_the_tree_of_a_fleet(knowledge: Knowledge) -> None:
    assert (
        text_of(hierarchy_tree(hierarchy_entries(matcher_of(parse_annotations(SSL), knowledge))))
        == """\
concepts
├── (sorts)
│   └── Object: eye, rover, uav1, uav2
│       └── Machine: eye, rover, uav1, uav2
│           ├── Camera: eye
│           └── Vehicle: rover, uav1, uav2
│               ├── Drone = UAV: uav1, uav2
│               │   └── Observer: uav2
│               └── UGV: rover
└── (features)
    ├── Altitude = Height[Vehicle]: float in m
    │   ├── a carries Altitude[uav1]
    │   └── BarometricAltitude[Vehicle]: float in m
    │       └── b carries BarometricAltitude[u] for every u in UAV
    ├── Daylight: boolean (no stream)
    ├── Power[Vehicle]: float in W
    │   └── c carries Power[rover]
    └── XYDist[UAV, Vehicle]: float in m (no stream)"""
    )


def test_an_explanation(knowledge: Knowledge) -> None:
    ssl = 'stream b contains BarometricAltitude[uav1] = z; stream a contains Altitude[uav1] = z'
    known = matcher_of(parse_annotations(ssl), knowledge)
    concept = parse_concept('BarometricAltitude[uav1]')
    assert (
        text_of(explanation_tree(str(concept), known.explain(concept)))
        == """\
BarometricAltitude[uav1]
├── matches
│   └── stream BarometricAltitude_uav1_from_b = select z as "BarometricAltitude[uav1]" from b
│       └── exact match: b carries BarometricAltitude[uav1]
└── does not match
    └── a carries Altitude[uav1]
        └── Altitude is above BarometricAltitude, not below it"""
    )


def test_a_feature_is_provided_by_those_below(knowledge: Knowledge) -> None:
    annotations = parse_annotations('stream b contains BarometricAltitude[uav1] = z')
    entries = map(asdict, hierarchy_entries(matcher_of(annotations, knowledge)))
    found = {each['name']: each for each in entries}
    assert found['Altitude']['is_provided']
    assert found['Altitude']['streams'] == ()
    assert not found['Power']['is_provided']


NAMES = [f'C{number}' for number in range(6)]


@given(st.lists(st.tuples(st.sampled_from(NAMES), st.sampled_from(NAMES)), max_size=10))
def test_parents_determine_the_order(pairs: list[tuple[str, str]]) -> None:
    here, rdf = 'http://here#', 'http://www.w3.org/1999/02/22-rdf-syntax-ns#'
    triples = [(here + each, f'{rdf}type', 'http://www.w3.org/2002/07/owl#Class') for each in NAMES]
    subclass_of = 'http://www.w3.org/2000/01/rdf-schema#subClassOf'
    knowledge = Knowledge([*triples, *((here + a, subclass_of, here + b) for a, b in pairs)])
    found = hierarchy_entries(Matcher(knowledge))
    parents = {each.name: set(each.parents) for each in found}
    assert sorted(name for each in found for name in (each.name, *each.equivalents)) == NAMES

    def above(name: str) -> set[str]:
        return parents[name].union(*map(above, parents[name]))

    for entry in found:
        strictly = set(knowledge.superconcepts(entry.name)) - {entry.name, *entry.equivalents}
        assert above(entry.name) == strictly & parents.keys()
        assert not any(above(one) & entry_parents for entry_parents in [parents[entry.name]]
                       for one in entry_parents)  # fmt: skip
    assert {
        line.strip('│├└─ ').partition(' ')[0]
        for line in text_of(hierarchy_tree(found)).splitlines()
    }
