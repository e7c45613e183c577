"""Plans that a vehicle executes, read from YAML files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dyknow_bringup.document import YamlEntry, read_document
from dyknow_coordinator import Holds, Plan, PlanAction, PlanFormula


@dataclass(frozen=True, slots=True)
class Task:
    """An action as it is executed.

    Args:
        action: its name.
        goal: a formula; when it is true, the action has succeeded.
        within: nanoseconds; when the goal is not reached by then, the action has failed.
    """

    action: str
    goal: str
    within: int


@dataclass(frozen=True, slots=True)
class Mission:
    """A plan to be monitored, and the tasks of its execution, one after the other."""

    plan: Plan
    tasks: tuple[Task, ...]


def load_mission(path: Path) -> Mission:
    """The mission of a YAML file.

    Raises:
        BringupError: for a file that is no mission; the message names the key and the mend.
    """
    entries = read_document(path).record(('name', 'actions'), ('formulas',))
    actions = [
        action.record(('name', 'goal', 'within'), ('formulas',))
        for action in entries['actions'].items()
    ]
    plan = Plan(
        name=entries['name'].text(),
        actions=tuple(PlanAction(each['name'].text(), _formulas(each)) for each in actions),
        formulas=_formulas(entries),
    )
    tasks = (
        Task(each['name'].text(), each['goal'].text(), each['within'].duration())
        for each in actions
    )
    return Mission(plan, tuple(tasks))


def _formulas(entries: dict[str, YamlEntry]) -> tuple[PlanFormula, ...]:
    return (
        tuple(_formula(entry) for entry in entries['formulas'].items())
        if 'formulas' in entries
        else ()
    )


def _formula(entry: YamlEntry) -> PlanFormula:
    entries = entry.record(('name', 'formula'), ('holds',))
    holds = _holds(entries['holds']) if 'holds' in entries else Holds.WHILE_EXECUTING
    return PlanFormula(entries['name'].text(), entries['formula'].text(), holds)


def _holds(entry: YamlEntry) -> Holds:
    known = {each.name.lower(): each for each in Holds}
    name = entry.text()
    if name not in known:
        raise entry.error(f"a formula cannot hold '{name}'; write one of {', '.join(known)}")
    return known[name]
