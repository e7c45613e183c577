"""Plans that a vehicle executes, read from YAML files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from dyknow_bringup.document import YamlEntry, read_document
from dyknow_coordinator import Holds, Plan, PlanAction, PlanFormula


@dataclass(frozen=True, slots=True)
class Task:
    """The execution of an action.

    Args:
        action: the name of the action.
        goal: a formula; the action succeeds when it is true.
        within: nanoseconds after which the action fails.
    """

    action: str
    goal: str
    within: int


@dataclass(frozen=True, slots=True)
class Mission:
    """A plan to be monitored, and the tasks of its execution in their order."""

    plan: Plan
    tasks: tuple[Task, ...]


def load_mission(path: Path) -> Mission:
    """Return the mission of a YAML file.

    Raises:
        BringupError: if the file is not a mission; the message names the key and the correction.
    """
    entries = read_document(path).record(('name', 'actions'), {'formulas': []})
    actions = [
        action.record(('name', 'goal', 'within'), {'formulas': []})
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
    return tuple(_formula(entry) for entry in entries['formulas'].items())


def _formula(entry: YamlEntry) -> PlanFormula:
    known = {each.name.lower(): each for each in Holds}
    entries = entry.record(('name', 'formula'), {'holds': Holds.WHILE_EXECUTING.name.lower()})
    holds = entries['holds'].text()
    if holds not in known:
        raise entries['holds'].error(
            f"a formula cannot hold '{holds}'; write one of {', '.join(known)}"
        )
    return PlanFormula(entries['name'].text(), entries['formula'].text(), known[holds])
