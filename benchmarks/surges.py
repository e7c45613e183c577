"""Verdicts over the streams of two engines, one of which fails around a surge.

python benchmarks/surges.py [--rounds 200] [--seed 1] [--logs FOLDER] [--json]

In each round, the level of a vehicle surges for 50 ms to 1.5 s, while one of two engines is killed
or stopped for 0.5 to 30 s. Its streams and those of the other vehicle are made by different
engines. Near the end of the timeout, when the system has recovered, another surge follows. The
judge knows only what the fleet has published:

- false: the last level that was published until `decided_at` is high,
- true: no level in the window was high,
- a formula that the last surge makes false must not end with a timeout.
"""

from __future__ import annotations

import argparse
import os
import random
import signal
import sys
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from dyknow_interfaces.msg import ExitStatus, StreamStatusArray
from dyknow_interfaces.srv import StreamDestroy
from parts import print_report
from processes import ENGINE, MANAGER, use_private_domain
from running_system import EVALUATE, FAR_ENGINE, RunningSystem, ask, outcome_of

from dyknow_common import NANOSECONDS, SECOND_NS
from dyknow_common.ros import LATCHED, time_to_nanoseconds

RATE = 20.0
PERIOD_NS = round(SECOND_NS / RATE)
CONSTRAINTS = 'with max_delay = 300 ms, sample_period = 50 ms, sample_period_deviation = 20 ms'
ANNOTATED = 'with max_delay = 1 s'
"""Constraints of the annotations, which the engine of the states checks again."""

VEHICLE = 'uav1'
HIGH, CALM = 500.0, 1.0
CALM_FORMULA = '(Power[uav1] < 100 or Power[uav2] > 1000)'
TIMEOUT_S = 20.0
LAST_SURGE_S = TIMEOUT_S - 5.5
WINDOW_S = 4
MARGIN_NS = 250 * NANOSECONDS['ms']
RECOVERY_S = 90.0


@dataclass
class Asked:
    """A formula and its answer; times of the monotonic clock, seconds."""

    formula: str
    begun: float = field(default_factory=time.monotonic)
    answer: Any = None

    @property
    def outcome(self) -> str:
        """The outcome in a word or two."""
        return outcome_of(self.answer)

    def fault(self, high: Sequence[int]) -> str:
        """Return the defect of the answer, given the stamps of high levels; empty if none."""
        outcome = self.outcome
        if outcome == 'lost':
            return 'not answered'
        decided = time_to_nanoseconds(self.answer.decided_at)
        last = decided // PERIOD_NS * PERIOD_NS
        if outcome == 'false':
            return '' if last in high else f'false over a value that was left before {decided}'
        if outcome == 'true':
            begun = decided - WINDOW_S * SECOND_NS + MARGIN_NS
            missed = [stamp for stamp in high if begun <= stamp <= decided - MARGIN_NS]
            return f'true, and {len(missed)} levels were high' if missed else ''
        is_missing = self.answer.exit_status.code == ExitStatus.TIMEOUT
        return f'missing: {self.answer.exit_status.message}' if is_missing else ''


class Rounds:
    """Rounds of surges and faults at random moments."""

    def __init__(self, system: RunningSystem, chance: random.Random) -> None:
        self.asked: list[Asked] = []
        self.faults: Counter[str] = Counter()
        self.descriptions: list[str] = []
        self._system = system
        self._chance = chance
        self._streams = StreamStatusArray()
        system.client.node.create_subscription(
            StreamStatusArray, f'{MANAGER}/streams', self._on_streams, LATCHED
        )

    def spread(self) -> None:
        """Have the streams of the two vehicles made by different engines."""

        def is_whole() -> bool:
            return len(self._streams.engines) > 1 and len(self._engines()) == len(system.batteries)

        system = self._system
        system.client.spin_until(is_whole, 'all streams on two engines', RECOVERY_S)
        if len(set(self._engines().values())) == 1:
            name = f'{VEHICLE}_power'
            system.client.call(StreamDestroy, f'{MANAGER}/stream_destroy', stream_name=name)
            text = f'select current as power from "/{VEHICLE}/battery" {CONSTRAINTS}'
            system.client.create(name, text, MANAGER)
            system.wait(1.0)

    def run(self) -> None:
        """Send formulas, have the level surge and an engine fail, and wait for the answers."""
        chance = self._chance
        asked = [self._ask(f'always {CALM_FORMULA}')]
        asked.append(self._ask(f'always[0 s, {WINDOW_S} s] {CALM_FORMULA}'))
        engine, kind = chance.choice((ENGINE, FAR_ENGINE)), chance.choice(('kill', 'stop'))
        surge, start = chance.uniform(0.05, 1.5), chance.uniform(0.5, 3.0)
        fault = start + chance.uniform(-0.5, surge + 0.5)
        lasts = 0.5 * 60 ** chance.random() if kind == 'stop' else chance.uniform(0.0, 3.0)
        self.faults[f'{engine} {kind}'] += 1
        self.descriptions.append(
            f'{engine} {kind} at {fault:.2f} s for {lasts:.2f} s, surge at {start:.2f} s '
            f'for {surge:.2f} s'
        )
        events = [
            (start, lambda: self._set(HIGH)),
            (start + surge, lambda: self._set(CALM)),
            (fault, lambda: self._fail(engine, kind)),
            (fault + lasts, lambda: self._repair(engine, kind)),
            (LAST_SURGE_S, lambda: self._set(HIGH)),
            (LAST_SURGE_S + 0.5, lambda: self._set(CALM)),
        ]
        begun = asked[0].begun
        for at, event in sorted(events, key=lambda each: each[0]):
            if at < LAST_SURGE_S or not all(each.answer for each in asked) or at == fault + lasts:
                self._system.wait(max(begun + at - time.monotonic(), 0.0))
                event()
        self._set(CALM)
        with_margin = TIMEOUT_S + 10.0
        self._system.client.spin_until(
            lambda: all(each.answer for each in asked), 'the answers', with_margin
        )
        self._system.client.spin_until(
            self._system.has_fleet_streams_only, 'just the streams of the fleet', RECOVERY_S
        )
        self._system.wait(3.0)
        self.spread()

    def latest(self) -> str:
        """Return what the last round was, and its answers."""
        answers = (
            f'{each.outcome} {each.answer.exit_status.message} {each.answer.explanation}'
            for each in self.asked[-2:]
        )
        return '\n  '.join([self.descriptions[-1], *answers])

    def _on_streams(self, message: Any) -> None:
        self._streams = message

    def _engines(self) -> dict[str, str]:
        return {each.name: each.engine for each in self._streams.streams if each.engine}

    def _ask(self, formula: str) -> Asked:
        asked = Asked(formula)
        self.asked.append(asked)

        def end(done: Any) -> None:
            asked.answer = done.result()

        ask(self._system.client, EVALUATE, formula, TIMEOUT_S).add_done_callback(end)
        return asked

    def _set(self, level: float) -> None:
        self._system.command('set', VEHICLE, level)

    def _fail(self, engine: str, kind: str) -> None:
        if kind == 'stop':
            os.killpg(self._system.pids[engine], signal.SIGSTOP)
        else:
            self._system.kill(engine)

    def _repair(self, engine: str, kind: str) -> None:
        if kind == 'stop':
            os.killpg(self._system.pids[engine], signal.SIGCONT)
        else:
            self._system.start(engine)


def report_of(rounds: Rounds, high: Mapping[str, Sequence[int]]) -> dict[str, Any]:
    """Return the outcomes, and the faulty answers with what was done in their rounds."""
    stamps = set(high.get(VEHICLE, ()))
    faults = [(number // 2, each, each.fault(stamps)) for number, each in enumerate(rounds.asked)]
    wrong = [
        f'round {number}: {each.formula}: {fault} ({rounds.descriptions[number]})'
        for number, each, fault in faults
        if fault
    ]
    return {
        'rounds': len(rounds.descriptions),
        'faults': dict(sorted(rounds.faults.items())),
        'outcomes': dict(sorted(Counter(each.outcome for each in rounds.asked).items())),
        'errors': dict(
            Counter(
                each.answer.exit_status.message[:150]
                for each in rounds.asked
                if each.answer is not None and each.answer.exit_status.code
            ).most_common(10)
        ),
        'wrong': [each for each in wrong if ': missing' not in each],
        'missing': [each for each in wrong if ': missing' in each],
    }


def main() -> None:
    """Run and print; the exit code is 1 if a verdict is wrong or missing."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rounds', type=int, default=200)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--logs', type=Path, help='an existing folder for the logs of the nodes')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = parser.parse_args()
    use_private_domain()
    chance = random.Random(arguments.seed)  # noqa: S311
    with RunningSystem(
        2, RATE, 1, CONSTRAINTS, annotated=ANNOTATED, far=True, logs=arguments.logs
    ) as system:
        rounds = Rounds(system, chance)
        rounds.spread()
        for _ in range(arguments.rounds):
            rounds.run()
            print(rounds.latest(), file=sys.stderr, flush=True)
        high = system.high_levels()
        codes = system.stop()
    found = {**report_of(rounds, high), 'exit_codes': codes}
    print_report(found, as_json=arguments.json)
    raise SystemExit(bool(found['wrong'] or found['missing']))


if __name__ == '__main__':
    main()
