"""Latency of a normal client of the ontology manager while another one sends hostile requests.

python benchmarks/semantics_latency.py [--json] [--seconds 20]
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from itertools import cycle
from pathlib import Path
from typing import Any

from dyknow_interfaces.srv import ConceptGetInstances, OntologyLoad, OntologyQuery
from processes import Client, use_private_domain

from dyknow_bringup.processes.launcher import Launcher
from dyknow_bringup.processes.processes import Process
from dyknow_bringup.resources import uav_ontology_path

NODE = 'ontology_manager'
PAUSE_S = 0.02
EVERYTHING = ' '.join(f'?s{n} ?p{n} ?o{n} .' for n in range(6))
TURTLE = '@prefix : <http://example.org/a#> . <http://example.org/a> a owl:Ontology .\n'
HOSTILE: tuple[tuple[Any, str, dict[str, str]], ...] = (
    (OntologyQuery, 'ontology_query', {'sparql': f'SELECT (COUNT(*) AS ?n) {{ {EVERYTHING} }}'}),
    (
        OntologyQuery,
        'ontology_query',
        {'sparql': f'SELECT ?x {{ ?x a owl:Class FILTER(REGEX("{"a" * 60}b", "^(a+)+$", "i")) }}'},
    ),
    (
        OntologyLoad,
        'ontology_load',
        {'content': f'{TURTLE} :a :b {"[ :b " * 5000} :c {"]" * 5000} .', 'format': 'turtle'},
    ),
    (OntologyLoad, 'ontology_load', {'path_or_iri': '/dev/zero'}),
)


def memory_mib(process: subprocess.Popen[bytes]) -> int:
    """Return the largest memory that a process has used."""
    status = Path(f'/proc/{process.pid}/status').read_text(encoding='ascii')
    return int(status.partition('VmHWM:')[2].split()[0]) // 1024


def measure(folder: Path, seconds: float) -> dict[str, Any]:
    """Return the latencies of the normal client in milliseconds, and the memory of the node."""
    client = Client()
    with Launcher(folder) as launcher:
        parameters = {'ontologies': [str(uav_ontology_path())]}
        process = launcher.start(Process('dyknow_semantics', NODE, parameters))
        try:
            latencies = sorted(_latencies(client, seconds))
        finally:
            client.close()
        return {
            'requests': len(latencies),
            'median_ms': round(latencies[len(latencies) // 2], 2),
            'p99_ms': round(latencies[len(latencies) * 99 // 100], 2),
            'max_ms': round(latencies[-1], 2),
            'node_mib': memory_mib(process),
        }


def _latencies(client: Client, seconds: float) -> list[float]:
    service = f'/{NODE}/concept_get_instances'
    client.call(ConceptGetInstances, service, concept_name='UAV')
    hostile, latencies = cycle(HOSTILE), []
    pending: list[Any] = []
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        pending = [each for each in pending if not each.done()]
        while len(pending) < len(HOSTILE):
            kind, name, fields = next(hostile)
            pending.append(client.request(kind, f'/{NODE}/{name}', **fields))
        begun = time.perf_counter()
        client.call(ConceptGetInstances, service, concept_name='UAV')
        latencies.append((time.perf_counter() - begun) * 1e3)
        time.sleep(PAUSE_S)
    return latencies


def main() -> int:
    """Print the measurements."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--json', action='store_true')
    parser.add_argument('--seconds', type=float, default=20.0)
    options = parser.parse_args()
    use_private_domain()
    with tempfile.TemporaryDirectory() as folder:
        found = measure(Path(folder), options.seconds)
    print(json.dumps(found) if options.json else found)
    return 0


if __name__ == '__main__':
    sys.exit(main())
