"""States that are lost when a stand-in takes over, and the cost of having it ready.

python benchmarks/take_overs.py [--json] [--quick] [--only states|cost]
"""

from __future__ import annotations

import time
from collections.abc import Callable
from statistics import median
from typing import Any, Final

from dyknow_interfaces.msg import EvaluationStatus, EvaluationStatusArray, FormulaResult
from parts import measure
from processes import use_private_domain
from rclpy.qos import DurabilityPolicy, QoSProfile
from running_system import COORDINATOR, RunningSystem

from dyknow_common import SECOND_NS

_USED_AND_STANDBY: Final = 2
LATCHED: Final = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
TIMING: Final = 'with max_delay = 500 ms, max_gap = 300 ms'
RATE: Final = 20.0
PERIOD_NS: Final = round(SECOND_NS / RATE)
BATTERIES: Final = 5
"""One in use, and others enough for one to be well: each is excluded for 10 s after its fault."""

SETTLED_S: Final = 2.0
"""Time after which a standby has had states, and better sources are in use again."""

EVER: Final = 'always Power[uav1] < 5'
SOON: Final = 'always[0 s, 2 s] Power[uav1] < 5'
HIGH: Final = 9.0
"""A level that makes these formulas false."""


class TakeOvers:
    """A running formula, whose sources are silenced one after the other."""

    def __init__(self, system: RunningSystem) -> None:
        self._system = system
        self._reports: list[Any] = []
        system.client.node.create_subscription(
            EvaluationStatusArray,
            f'{COORDINATOR}/evaluations',
            lambda message: self._reports.append(message.evaluations),
            LATCHED,
        )
        system.warm_up()
        known = set(system.progress)
        self._answer = system.ask(EVER, 3600.0)
        system.wait_for_running(1, known)
        (self._key,) = system.progress.keys() - known
        states, valid = system.progress[self._key][0]
        self._first = valid - (states - 1) * PERIOD_NS
        self._standby: set[str] = set()
        self.wait_for_standby()

    @property
    def source(self) -> str:
        """The battery that the states are made of."""
        assert not self._answer.done(), self._answer.result()
        # All formulas of the group have the same states.
        groundings = [
            each.groundings
            for each in self._reports[-1]
            if each.formula_group_id == self._key[0] and each.phase != EvaluationStatus.ENDED
        ]
        return _battery(groundings[0])

    @property
    def lost(self) -> int:
        """The number of ticks without a state, from the first state to the latest."""
        states, valid = self._system.progress[self._key][-1]
        return (valid - self._first) // PERIOD_NS + 1 - states

    def falsifying(self) -> str:
        """Wait until the formula is false, and return the battery that decided it."""
        self._until(self._answer.done, 'the surge of the stand-in is seen')
        answer = self._answer.result()
        assert answer.verdict == FormulaResult.FALSE, answer
        return _battery(answer.groundings)

    def wait_for_standby(self) -> None:
        """Wait until another standby has had states for a while."""
        found: set[str] = set()

        def is_new() -> bool:
            found.clear()
            found.update(each for each in self._system.streams() if 'states_' in each)
            return len(found) == _USED_AND_STANDBY and not found <= self._standby

        self._until(is_new, 'a standby', 30.0)
        self._standby = set(found)
        self._system.wait(SETTLED_S)

    def silence(self) -> str:
        """Silence the source in use, and return its name."""
        silent = self.source
        self._system.command('pause', silent)
        return silent

    def wait_for_another(self, silent: str) -> None:
        """Wait until another source is in use."""
        self._until(lambda: self.source != silent, 'another source')

    def resume(self, silent: str) -> None:
        """Let a source publish again, and wait for the next standby."""
        self._system.command('resume', silent)
        self.wait_for_standby()

    def _until(self, condition: Callable[[], bool], what: str, limit: float = 10.0) -> None:
        self._system.client.spin_until(condition, what, limit)


def _battery(groundings: Any) -> str:
    return str(groundings[0].stream).partition(' from ')[2].removesuffix('_power')


def states(*, quick: bool) -> Any:
    """Count the states that are lost in 100 take-overs, and the verdicts that are missing."""
    return [
        {'nodes': name, **_states(10 if quick else 100, composition=composition)}
        for name, composition in (('one_process', True), ('processes', False))
    ]


def _states(number: int, *, composition: bool) -> dict[str, Any]:
    _check(composition=composition)
    with RunningSystem(
        1, RATE, BATTERIES, TIMING, progress_period=0.2, composition=composition
    ) as system:
        running = TakeOvers(system)
        missing = 0
        for _ in range(number):
            question = system.ask(SOON)
            system.wait(0.3)
            silent = running.silence()
            running.wait_for_another(silent)
            system.client.spin_until(question.done, 'a verdict')
            missing += question.result().verdict != FormulaResult.TRUE
            running.resume(silent)
        return {'take_overs': number, 'states_lost': running.lost, 'verdicts_missing': missing}


def _check(*, composition: bool) -> None:
    """Check that a surge is seen that begins and ends before the silence is noticed."""
    with RunningSystem(
        1, RATE, BATTERIES, TIMING, progress_period=0.2, composition=composition
    ) as system:
        running = TakeOvers(system)
        silent = running.silence()
        for level in (HIGH, 1.0):
            time.sleep(0.1)
            for each in system.batteries:
                system.command('set', each, level)
        assert running.falsifying() != silent


def cost(*, quick: bool) -> Any:
    """Measure the cost of a standby, at 100 states a second: a formula that has one, and not."""
    rows = []
    seconds, rounds = (5.0, 2) if quick else (20.0, 6)
    for name, composition in (('one_process', True), ('processes', False)):
        with RunningSystem(1, 100.0, 2, composition=composition) as system:
            system.warm_up()
            found: dict[str, list[tuple[float, float]]] = {}
            for _ in range(rounds):
                for formula in (EVER, 'always uav1_power.power < 5'):
                    known = set(system.progress)
                    answer = system.ask(formula, seconds + 5.0)
                    system.wait_for_running(1, known)
                    system.wait(1.0)
                    is_ready = sum('states_' in each for each in system.streams())
                    assert is_ready == 1 + (formula == EVER), system.streams()
                    costs = system.costs(seconds).values()
                    share = sum(each['share'] for each in costs)
                    memory = sum(each['memory_mb'] for each in costs)
                    found.setdefault(formula, []).append((share, memory))
                    system.client.spin_until(answer.done, 'the end of the formula')
            (share, memory), (bare, bare_memory) = (
                map(median, zip(*each, strict=True)) for each in found.values()
            )
            rows.append(
                {
                    'nodes': name,
                    'us_per_state': round((share - bare) / 100.0 * 1e6),
                    'us_per_state_without': round(bare / 100.0 * 1e6),
                    'memory_mb': round(memory - bare_memory, 2),
                }
            )
    return rows


if __name__ == '__main__':
    use_private_domain()
    measure(__doc__, states, cost)
