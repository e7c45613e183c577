"""The semantics command: what the ontologies say, which streams carry it, and why some match."""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from dyknow_interfaces.srv import ListSemanticSpecifications, OntologyQuery
from rich.console import Console

from dyknow_common import SECOND_NS, DyKnowError, ExitCode
from dyknow_common.ros import SERVICE, CommandNode, duration, run_command, snake_case
from dyknow_semantics.annotations.parsing import parse_annotations, parse_concept
from dyknow_semantics.errors import SemanticsError
from dyknow_semantics.matching.bridges import bridged, parse_bridges
from dyknow_semantics.matching.matching import Matcher
from dyknow_semantics.ontology.store import ALL_TRIPLES
from dyknow_semantics.reporting.hierarchy import as_json, as_tree, entries, explanation_tree
from dyknow_semantics.ros.files import read_all


class Asker:
    """Asks the nodes of meaning for all that they know.

    Args:
        command: the node that asks.
        timeout: how long to wait for an answer, nanoseconds.
    """

    def __init__(self, command: CommandNode, timeout: int) -> None:
        self._command = command
        self._timeout = timeout

    def ask(self, service_type: Any, node: str, **fields: Any) -> Any:
        """The response of a service.

        Raises:
            SemanticsError: UNAVAILABLE, when none comes in time; what the node refuses.
        """
        name = f'{node}/{snake_case(service_type.__name__)}'
        client = self._command.node.create_client(service_type, name, qos_profile=SERVICE)
        end = self._command.end_of_wait(self._timeout)
        self._command.spin_until(client.service_is_ready, end, lambda: self._silence(node))
        future = client.call_async(service_type.Request(**fields))
        self._command.spin_until(future.done, end, lambda: self._silence(node))
        response = future.result()
        if response.exit_status.code != ExitCode.SUCCESS:
            raise SemanticsError(response.exit_status.message, ExitCode(response.exit_status.code))
        return response

    def _silence(self, node: str) -> SemanticsError:
        name = self._command.node.resolve_service_name(node)
        return SemanticsError(
            f'{name} has not answered within {self._timeout / SECOND_NS:g} s; is DyKnow running, '
            'in this namespace and ROS domain?',
            ExitCode.UNAVAILABLE,
        )


def matcher(chosen: argparse.Namespace, asker: Asker) -> Matcher:
    """All that the nodes know.

    Raises:
        DyKnowError: when a node does not answer, or a file of bridges is wrong.
    """
    bridges = read_all(map(Path, chosen.bridges), 'bridges', parse_bridges)
    values = list(asker.ask(OntologyQuery, chosen.ontology_manager, sparql=ALL_TRIPLES).values)
    texts = asker.ask(ListSemanticSpecifications, chosen.semantics_manager).ssl_statements
    ontologies = bridged(zip(values[0::3], values[1::3], values[2::3], strict=True), bridges)
    if ontologies.faults:
        raise SemanticsError('\n'.join(ontologies.faults))
    found = Matcher(ontologies.known, ontologies.stated)
    found.update({str(each): each for text in texts for each in parse_annotations(text)})
    return found


def show(chosen: argparse.Namespace, known: Matcher) -> None:
    """Prints the hierarchies, or why streams match a concept.

    Raises:
        LanguageError: if the concept makes no sense relative to the ontologies.
    """
    console = Console(highlight=False)
    if chosen.explain:
        concept = parse_concept(chosen.explain)
        explained = known.explain(concept)
        if chosen.json:
            print(json.dumps([asdict(each) for each in explained]))  # noqa: T201 - a command
        else:
            console.print(explanation_tree(str(concept), explained))
        return
    found = entries(known)
    if chosen.json:
        answer = {'concepts': as_json(found), 'faults': dict(known.faults)}
        print(json.dumps(answer))  # noqa: T201 - a command
        return
    console.print(as_tree(found))
    for text, fault in known.faults.items():
        console.out(f'this annotation makes no sense: {text}\n  {fault}')


def options(arguments: Sequence[str]) -> argparse.Namespace:
    """The options on the command line."""
    parser = argparse.ArgumentParser(
        prog='semantics',
        description=f'{__doc__} Exit code 0: shown, 1: no such concept, 2: a node does not answer.',
    )
    parser.add_argument(
        '--explain', metavar='CONCEPT', help='why each stream matches it, or nearly does'
    )
    parser.add_argument(
        '--bridges', metavar='FILE', action='append', default=[], help='bridges to follow'
    )
    parser.add_argument('--json', action='store_true', help='print a line of JSON')
    parser.add_argument(
        '--timeout', type=duration, default='5 s', help='to wait for an answer (default: 5 s)'
    )
    for role, default in (
        ('ontology-manager', 'ontology_manager'),
        ('semantics-manager', 'stream_semantics_manager'),
    ):
        parser.add_argument(
            f'--{role}', default=default, help=f'the node that is asked (default: {default})'
        )
    return parser.parse_args(arguments)


def _work(chosen: argparse.Namespace, command: CommandNode) -> None:
    show(chosen, matcher(chosen, Asker(command, chosen.timeout)))


def _exit_code(error: DyKnowError) -> int:
    return 2 if error.code is ExitCode.UNAVAILABLE else 1


def main() -> int:
    """The executable semantics."""
    return run_command('semantics', options, _work, _exit_code)
