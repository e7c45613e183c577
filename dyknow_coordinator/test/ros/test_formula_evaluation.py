"""The status of an evaluation, without nodes."""

from __future__ import annotations

from itertools import count
from types import SimpleNamespace
from typing import Any

from dyknow_coordinator.evaluation import EvaluationRequest
from dyknow_coordinator.ros.evaluation.formula_evaluation import FormulaEvaluation


def test_an_evaluation_starts_no_earlier_than_simulated_time() -> None:
    times = iter((0, 0, 1_700_000_000, 1_700_000_005))
    node = SimpleNamespace(now=lambda: next(times))
    context: Any = SimpleNamespace(node=node, names=map(str, count(1)))
    groups: Any = None
    evaluation = FormulaEvaluation(context, groups, EvaluationRequest('p'), lambda: None)
    started = [evaluation.status().started for _ in range(4)]
    assert started == [0, 1_700_000_000, 1_700_000_000, 1_700_000_000]
