"""The function `check_trace` and the command `check`: formulas over a recorded trace."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from dyknow_common import DyKnowError, Verdict, open_text, read_text, round_time
from dyknow_common.executables import ERROR, FALSE, SUCCESS, run_main
from dyknow_reasoning.errors import ReasoningError
from dyknow_reasoning.formula_group import FormulaGroup
from dyknow_reasoning.progression.instances import Domains
from dyknow_reasoning.results import FormulaResult
from dyknow_reasoning.trace import RecordedState, read_trace

_EPILOG = """\
A trace has a column of increasing times, time_ns (integers) or time_s (decimals), and a column
for each ground feature, such as "XYDist[uav1,uav2]" (a name with a comma is quoted). Each row is a
state.

The header of a column may name its type: "mode: string". The types are int, float, string and
boolean. Otherwise its first value decides if the column holds booleans (true, false), numbers or
strings. A value of another type is an error. An empty cell holds no value. Quotes and spaces
around a value have no meaning.

Exit code: 0 if no formula is false, 1 if one is, 2 for an error."""


@dataclass(frozen=True, slots=True)
class CheckResult:
    """The result of a formula over a trace.

    Args:
        formula: the canonical text of the formula.
        verdict: undecided if the trace ends too early or the formula failed.
        decided_at: the valid time of the deciding state in nanoseconds; None if undecided, or if
            the verdict needs no state.
        decided_at_state: the index of the deciding state, from 0; None as for `decided_at`.
        states: the number of states of the trace.
        explanation: the reasons; for an undecided formula, what remains of it.
        error: the reason why the formula failed.
    """

    formula: str
    verdict: Verdict
    decided_at: int | None
    decided_at_state: int | None
    states: int
    explanation: str
    error: ReasoningError | None = None


def check_trace(
    formulas: Sequence[str], domains: Domains, trace: Iterable[RecordedState]
) -> list[CheckResult]:
    """Progress formulas over a trace; return a result for each, in their order.

    Args:
        formulas: the texts of the formulas.
        domains: the objects of each sort.
        trace: the states, in the order of their valid times.

    Raises:
        LanguageError: for a text that is not a formula.
        ReasoningError: for a sort without a domain.
    """
    group = FormulaGroup()
    ids = [group.add_formula(text, text) for text in formulas]
    group.begin(domains)
    results: dict[int, tuple[int | None, FormulaResult]] = {
        result.formula_id: (None, result) for result in group.decided_at_once()
    }
    states = 0
    for state in trace:
        for result in group.progress(state.valid_time, state.values):
            results[result.formula_id] = (states, result)
        states += 1
    return [_result(group, formula_id, results.get(formula_id), states) for formula_id in ids]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command `check`.

    Returns:
        0 if no formula is false, 1 if one is, 2 for bad input.
    """
    return run_main('check', lambda: _check(_parser().parse_args(arguments)))


def _check(options: argparse.Namespace) -> int:
    try:
        results = _results(options)
    except DyKnowError as error:
        if options.json:
            sys.stdout.write(f'{json.dumps({"error": _json_error(error)}, ensure_ascii=False)}\n')
        raise
    for result in results:
        sys.stdout.write(f'{_json(result) if options.json else _report(result)}\n')
        if result.error:
            sys.stderr.write(f'{result.formula}: {result.error}\n')
    if any(result.error for result in results):
        return ERROR
    return FALSE if any(result.verdict is Verdict.FALSE for result in results) else SUCCESS


def _results(options: argparse.Namespace) -> list[CheckResult]:
    with open_text(Path(options.trace), 'trace', ReasoningError) as lines:
        formulas = [*options.formula, *_read_formulas(options.formulas)]
        if not formulas:
            raise ReasoningError('there is no formula to check; give one, or --formulas FILE')
        return check_trace(formulas, read_domains(options.domain), read_trace(lines))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog='check',
        description='Check formulas over a recorded trace.',
        epilog=_EPILOG,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument('formula', nargs='*', metavar='FORMULA', help='a formula to check')
    parser.add_argument(
        '--formulas', metavar='FILE', help='more formulas, one a line; # begins a comment line'
    )
    add_domain_option(parser)
    parser.add_argument(
        '--trace', required=True, metavar='FILE', help='comma-separated values in UTF-8, see below'
    )
    parser.add_argument(
        '--json',
        action='store_true',
        help='print a line of JSON for each formula, or one with the error of the input',
    )
    return parser


def _read_formulas(path: str | None) -> list[str]:
    if path is None:
        return []
    lines = read_text(Path(path), 'formulas', ReasoningError).splitlines()
    return [line for line in lines if line.strip() and not line.lstrip().startswith('#')]


def add_domain_option(parser: argparse.ArgumentParser) -> None:
    """Add the option `--domain`, whose values `read_domains` reads."""
    parser.add_argument(
        '--domain',
        action='append',
        default=[],
        metavar='SORT=OBJECT,...',
        help='the objects of a sort, such as UAV=uav1,uav2; once for each sort',
    )


def read_domains(options: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Return the objects of each sort.

    Args:
        options: such as `UAV=uav1,uav2`.

    Raises:
        ReasoningError: for an option that is no domain, or a second one of a sort.
    """
    domains: dict[str, tuple[str, ...]] = {}
    for option in options:
        sort, found, objects = (part.strip() for part in option.partition('='))
        if not found or not sort:
            raise ReasoningError(f"'{option}' is not a domain; write it as UAV=uav1,uav2")
        if sort in domains:
            raise ReasoningError(f"the sort '{sort}' has two domains; give it one")
        domains[sort] = tuple(name.strip() for name in objects.split(',') if name.strip())
    return domains


def _result(
    group: FormulaGroup,
    formula_id: int,
    found: tuple[int | None, FormulaResult] | None,
    states: int,
) -> CheckResult:
    formula = str(group.formulas[formula_id])
    if found is None:
        text = f'undecided after {states} states; what remains: {group.residual(formula_id)}'
        return CheckResult(formula, Verdict.UNDECIDED, None, None, states, text)
    index, result = found
    index, text = (None, result.error.message) if result.error else (index, result.explanation)
    verdict, decided_at = result.verdict, result.decided_at
    return CheckResult(formula, verdict, decided_at, index, states, text, result.error)


def _report(result: CheckResult) -> str:
    if result.error:
        return f'{result.formula}\n  failed: {result.explanation}'
    if result.verdict is Verdict.UNDECIDED:
        return f'{result.formula}\n  {result.explanation}'
    decided = result.verdict.name.lower()
    if result.decided_at is not None:
        decided += f' at {round_time(result.decided_at)} (state {result.decided_at_state})'
    return f'{result.formula}\n  {decided}\n  {result.explanation}'


def _json(result: CheckResult) -> str:
    return json.dumps(
        {
            'formula': result.formula,
            'verdict': result.verdict.name.lower(),
            'decided_at_ns': result.decided_at,
            'decided_at_state': result.decided_at_state,
            'states': result.states,
            'explanation': result.explanation,
            'error': result.error and _json_error(result.error),
        },
        ensure_ascii=False,
    )


def _json_error(error: DyKnowError) -> dict[str, str]:
    return {'code': error.code.name, 'message': error.message}
