"""Cost of matching: alone, after a change, as a service. Equality with a scan is checked first.

python benchmarks/semantics.py [--json] [--only matching|changes|ontology|service] [--quick]
"""

from __future__ import annotations

import json
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from dyknow_interfaces.srv import FindAllMatchingStreams
from parts import measure, processor_times
from processes import Client, use_private_domain, wait_until_begun, worker
from workers import EMPTY_SERVICE

from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import Process
from dyknow_semantics import (
    Annotation,
    Knowledge,
    Matcher,
    Ontology,
    Triple,
    parse_annotations,
    parse_concept,
)

HERE = 'http://www.example.org/benchmark#'
RDF_TYPE = 'http://www.w3.org/1999/02/22-rdf-syntax-ns#type'
SUBCLASS_OF = 'http://www.w3.org/2000/01/rdf-schema#subClassOf'
OWL_CLASS = 'http://www.w3.org/2002/07/owl#Class'
DYKNOW = 'http://www.dyknow.org/ontology#'
MATCHING_SERVICE = '/semantic_matching_engine/find_all_matching_streams'
WARM_UP_ROUNDS = 10
"""The first calls include discovery."""

CONCEPT = parse_concept('F0[u] for every u in UAV')


def triples(features: int, objects: int) -> list[Triple]:
    """Return an ontology with features of one sort, and objects of that sort."""
    found: list[Triple] = [(f'{HERE}UAV', RDF_TYPE, OWL_CLASS)]
    for name in (f'{HERE}F{number}' for number in range(features)):
        found += [
            (name, RDF_TYPE, OWL_CLASS),
            (name, SUBCLASS_OF, f'{DYKNOW}Feature'),
            (name, f'{DYKNOW}argument1', f'{HERE}UAV'),
            (name, f'{DYKNOW}value_type', 'float'),
        ]
    found += [(f'{HERE}uav{number}', RDF_TYPE, f'{HERE}UAV') for number in range(objects)]
    return found


def write_ontology(path: Path, features: int, objects: int) -> Path:
    """Write the same ontology to a file of N-Triples."""
    lines = [f'<{HERE[:-1]}> <{RDF_TYPE}> <http://www.w3.org/2002/07/owl#Ontology> .']
    for subject, predicate, value in triples(features, objects):
        text = f'<{value}>' if value.startswith('http') else json.dumps(value)
        lines.append(f'<{subject}> <{predicate}> {text} .')
    path.write_text('\n'.join(lines) + '\n', encoding='utf-8')
    return path


def annotations(specifications: int, relevant: int) -> dict[str, Annotation]:
    """Return annotations: some of F0, and each other one of a feature of its own."""
    ssl = [
        f'stream s{number} contains '
        f'F{max(0, number - relevant + 1)}[uav{min(number, relevant - 1)}] = value;'
        for number in range(specifications)
    ]
    return {text: parse_annotations(text)[0] for text in ssl}


def milliseconds(function: Callable[[], object], repetitions: int) -> float:
    """Return the median processor time of a call."""
    return round(statistics.median(processor_times(function, repetitions)) * 1e3, 4)


def scan(found: dict[str, Annotation]) -> list[tuple[str, str]]:
    """Return the matches by a scan of all annotations."""
    contents = ((each.stream, each.contents[0].feature) for each in found.values())
    return sorted((stream, str(feature)) for stream, feature in contents if feature.name == 'F0')


def matching(*, quick: bool) -> Any:
    """Measure repeated requests for a concept, and the first one separately."""
    rows = []
    for specifications, relevant, features in (
        (2_000, 1, 2_000),
        (2_000, 10, 2_000),
        (10_000 if quick else 100_000, 10, 10_000 if quick else 100_000),
        (2_000, 2_000, 1),
    ):
        known = annotations(specifications, relevant)
        matcher = Matcher(Knowledge(triples(features, max(relevant, 1))))
        matcher.set_annotations(known)
        begun = time.perf_counter()
        found = matcher.match(CONCEPT)
        first_s = time.perf_counter() - begun
        carried = [(str(each.declaration.stream.inputs[0]), each.ground_feature) for each in found]
        assert sorted(carried) == scan(known), 'differs from the scan'
        repetitions = 20 if quick else 200
        rows.append({
            'specifications': specifications,
            'relevant': relevant,
            'features': features,
            'ms': milliseconds(lambda: matcher.match(CONCEPT), repetitions),  # noqa: B023
            'first_ms': round(first_s * 1e3, 4),
            'scan_ms': milliseconds(lambda: scan(known), 5),  # noqa: B023
        })  # fmt: skip
    return rows


def changes(*, quick: bool) -> Any:
    """Measure the addition of an annotation and of an object to 2,000 annotations."""
    matcher = Matcher(Knowledge(triples(2_000, 10)))
    matcher.set_annotations(annotations(2_000, 10))
    text = 'stream new contains F0[uav0] = value;'
    new = parse_annotations(text)[0]

    def add_and_remove() -> None:
        matcher.add(text, new)
        matcher.remove(text)

    ontologies = [Knowledge(triples(2_000, number)) for number in (11, 10)] * (2 if quick else 10)
    changes = iter(ontologies)
    object_change = milliseconds(lambda: matcher.set_knowledge(next(changes)), len(ontologies))
    assert matcher.match(CONCEPT) == match_from_scratch(2_000, 10)
    return {
        'add_and_remove_annotation_ms': milliseconds(add_and_remove, 100),
        'add_or_remove_object_ms': object_change,
        'rebuild_ms': milliseconds(lambda: match_from_scratch(2_000, 10), 2),
    }


def match_from_scratch(specifications: int, relevant: int) -> object:
    """Return the answer of a new matcher."""
    matcher = Matcher(Knowledge(triples(specifications, relevant)))
    matcher.set_annotations(annotations(specifications, relevant))
    return matcher.match(CONCEPT)


def ontology(*, quick: bool) -> Any:
    """Measure the loading of classes."""
    classes = 500 if quick else 5_000
    with tempfile.TemporaryDirectory() as folder, Ontology() as loaded:
        path = write_ontology(Path(folder, 'benchmark.nt'), classes, 1)
        begun = time.perf_counter()
        loaded.load(path)
        loading = time.perf_counter() - begun
        assert len(loaded.knowledge.features) == classes
    return {'classes': classes, 'load_seconds': round(loading, 2)}


def service(*, quick: bool) -> Any:
    """Measure the round trips of a request and of a service with an empty answer."""
    use_private_domain()
    rounds = 50 if quick else 500
    with tempfile.TemporaryDirectory() as folder:
        ssl = Path(folder, 'benchmark.ssl')
        ssl.write_text('\n'.join(annotations(2_000, 1)), encoding='utf-8')
        owl = write_ontology(Path(folder, 'benchmark.nt'), 2_000, 1_000 if quick else 10_000)
        package = 'dyknow_semantics'
        with Launcher(Path(folder)) as launcher, worker('empty_service') as empty:
            launcher.start(Process(package, 'ontology_manager', {'ontologies': [str(owl)]}))
            given = {'annotations': [str(ssl)]}
            launcher.start(Process(package, 'stream_semantics_manager', given))
            launcher.start(Process(package, 'semantic_matching_engine', {}))
            wait_until_begun(empty)
            with Client() as client:
                return _round_trips(client, rounds)


def _round_trips(client: Client, rounds: int) -> dict[str, float]:
    """Return the times of both services, which are called in turn."""
    times: dict[str, list[float]] = {EMPTY_SERVICE: [], MATCHING_SERVICE: []}
    for number in range(rounds + WARM_UP_ROUNDS):
        for name, found in times.items():
            begun = time.perf_counter()
            answer = client.call(FindAllMatchingStreams, name, concept=str(CONCEPT))
            if number >= WARM_UP_ROUNDS:
                found.append(time.perf_counter() - begun)
                assert len(answer.stream_specifications) == (name == MATCHING_SERVICE), answer
    empty, full = (statistics.median(each) * 1e3 for each in times.values())
    return {
        'empty_ms': round(empty, 3),
        'matching_ms': round(full, 3),
        'ratio': round(full / empty, 2),
    }


if __name__ == '__main__':
    measure(__doc__, matching, changes, ontology, service)
