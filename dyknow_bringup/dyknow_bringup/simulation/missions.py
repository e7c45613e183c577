"""Plans that a vehicle executes, read from YAML files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from dyknow_configuration import YamlValue, read_yaml
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
        ConfigurationError: if the file is not a mission; the message shows the place of the fault.
    """
    values = read_yaml(path).mapping(('name', 'actions', 'formulas'), ('name', 'actions'))
    keys = 'name', 'goal', 'within'
    actions = [each.mapping((*keys, 'formulas'), keys) for each in values['actions'].items()]
    plan = Plan(
        name=values['name'].line(),
        actions=tuple(PlanAction(each['name'].line(), _formulas(each)) for each in actions),
        formulas=_formulas(values),
    )
    tasks = (
        Task(
            each['name'].line(), each['goal'].text().strip(), each['within'].non_negative_duration()
        )
        for each in actions
    )
    return Mission(plan, tuple(tasks))


def _formulas(values: Mapping[str, YamlValue]) -> tuple[PlanFormula, ...]:
    return tuple(map(_formula, values['formulas'].items())) if 'formulas' in values else ()


def _formula(value: YamlValue) -> PlanFormula:
    values = value.mapping(('name', 'formula', 'holds'), ('name', 'formula'))
    known = {each.name.lower(): each for each in Holds}
    holds = Holds.WHILE_EXECUTING
    if 'holds' in values:
        holds = known[values['holds'].choice('time of a formula', known)]
    return PlanFormula(values['name'].line(), values['formula'].text().strip(), holds)
