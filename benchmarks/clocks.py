"""Verdicts over two robots whose clocks are off, judged by the true times of their values.

python benchmarks/clocks.py [--questions 1000] [--seed 1] [--without-gaps] [--logs FOLDER] [--json]

Two processes, a robot each (`clock_robots.py`), publish levels that are high or low. In each
*episode*, the clock of a robot is off by -5 to 5 s, often by nothing or by less than 100 ms, and
its stamped messages come 0 to 1.5 s after the true times, with jitter. Some robots stall: once, no
stamped message leaves them for up to 1.5 s. Other topics have no stamps, or leave them at zero:
their values hold from the time at which they are sent. All questions about an episode are asked at
the same time, over the topics, or over streams that state a `max_delay`.

Allowed, by docs/time.md: when a message is received, its stamp is at most `max_lead` (100 ms) ahead
of the clock, and at most `max_delay` (as stated, or 1 s) behind it. So the clock of a robot may be
off by `delay - max_delay` to `delay + max_lead`, as nothing tells an offset from a delay. The judge
knows the true times, the stamps, and the times before and after each publication:

- If all messages until `decided_at` are within the limits, a verdict must be that of the states
  with their stamps until then. If it contradicts the true times, an allowed offset is the reason:
  it is counted apart.
- If one has broken a limit, a verdict must be that of the true times, for a begin that differs from
  the demanded one by at most 300 ms.
- An error is allowed if it names a message that breaks a limit, or comes within the 100 ms of
  transport of it; or if it names the message before or after one that is missed for this reason. A
  timeout is allowed if a message broke a limit meanwhile. All other errors are not.

A stated `max_delay` is a promise: by it, the clock makes a value certain. A later message is a
violation, but it may come after a verdict. A `max_gap` notices that messages are missing, so the
streams of episodes with a stall state one of 200 ms. `--without-gaps` leaves it out; verdicts over
values that a stall has made out of date are then counted as wrong.
"""

from __future__ import annotations

import argparse
import json
import random
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path
from typing import Any

from builtin_interfaces.msg import Duration
from clock_judgement import (
    JUDGEMENTS,
    MAX_DELAY_NS,
    MAX_LEAD_NS,
    NOT_ALLOWED,
    WRONG,
    Judge,
    Level,
    Question,
)
from clock_robots import KINDS, MS, PROGRAM, STAMPED, Episode, Message
from dyknow_interfaces.msg import StreamConstraints
from dyknow_interfaces.srv import EvaluateFormula, StreamDestroy
from parts import print_report
from processes import MANAGER, use_private_domain, wait_for_line, worker
from running_system import EVALUATE, RunningSystem

from dyknow_common.ros import nanoseconds_to_time
from robots import stop

ROBOTS = ('a', 'b')
EPISODES = 3
"""The number of episodes at once: a round."""

QUESTIONS = 5
"""The number of questions about an episode."""

ROUND_S = 9.5
ASKED_AFTER_S = 2.0
TIMEOUT_S = 8
BEGIN_MS = (1500, 2500)
"""The least and the greatest time from a question to its first state."""

STATED_MS = (500, 1000, 2000)
ANSWER_LIMIT_S = 30.0


SHAPES = (
    'always[0 s, 1500 ms] not ({0} > 0.5 and {1} > 0.5)',
    'eventually[0 s, 1 s] ({0} > 0.5 and {1} > 0.5)',
    'always[0 s, 1 s] ({0} > 0.5 -> eventually[0 s, 800 ms] {1} > 0.5)',
    '(not {0} > 0.5) until[0 s, 1500 ms] {1} > 0.5',
    'eventually[0 s, 1 s] always[0 s, 500 ms] not ({0} > 0.5 and not {1} > 0.5)',
)
"""Formulas, with placeholders for the levels of two robots."""


class Rounds:
    """Rounds of episodes at the same time, and the questions about them."""

    def __init__(
        self,
        system: RunningSystem,
        robots: Mapping[str, Any],
        chance: random.Random,
        *,
        states_gaps: bool,
    ) -> None:
        self.judged: list[tuple[Question, str]] = []
        self.descriptions: dict[int, str] = {}
        self._system = system
        self._robots = robots
        self._chance = chance
        self._states_gaps = states_gaps
        self._with_gap: set[int] = set()

    def run(self) -> None:
        """Have the robots perform episodes, ask about them, and judge the answers."""
        first = len(self.descriptions)
        numbers = range(first, first + EPISODES)
        for robot, process in self._robots.items():
            _send(process, [self._episode(robot, number) for number in numbers])
        for process in self._robots.values():
            wait_for_line(process)
        begun = time.monotonic()
        stated = {number: self._state(number) for number in numbers}
        self._system.wait(begun + ASKED_AFTER_S - time.monotonic())
        asked = [self._ask(each, stated[each]) for each in numbers for _ in range(QUESTIONS)]
        self._system.client.spin_until(
            lambda: all(each.answer for each in asked), 'the answers', ANSWER_LIMIT_S
        )
        for name in (f'{robot}{number}_stated' for number in numbers for robot in ROBOTS):
            self._system.client.call(StreamDestroy, f'{MANAGER}/stream_destroy', stream_name=name)
        messages = _messages(self._robots.values())
        self.judged.extend((each, Judge(each, messages).judgement()) for each in asked)

    def _episode(self, robot: str, number: int) -> Episode:
        chance = self._chance
        delay = chance.randint(0, chance.choice((20, 20, 400, 800, 1300)))
        jitter = chance.randint(0, chance.choice((50, 200)))
        stall = chance.choice((0, 0, chance.randint(100, 1500)))
        if stall and self._states_gaps:
            self._with_gap.add(number)
        offset = self._offset(delay, jitter)
        self.descriptions[number] = (
            self.descriptions.get(number, '')
            + f'{robot}: offset {offset}, delay {delay} to {delay + jitter}, stall {stall}; '
        )
        times = (each * MS for each in (offset, delay, jitter, stall))
        return Episode(number, *times, chance.getrandbits(32))

    def _offset(self, delay: int, jitter: int) -> int:
        """Return how far a clock is ahead; in some episodes such that it is near a limit."""
        chance = self._chance
        near = delay + chance.randint(0, jitter)
        limit = chance.choice((-MAX_LEAD_NS // MS, MAX_DELAY_NS // MS, *STATED_MS))
        most = chance.choice((0, 0, 0, 100, 100, 100, 100, 1500, 5000, None))
        return near - limit if most is None else chance.randint(-most, most)

    def _state(self, number: int) -> int:
        """Create streams of the stamped topics with a max_delay, and return it, milliseconds."""
        stated = self._chance.choice(STATED_MS)
        gap = ', max_gap = 200 ms' if number in self._with_gap else ''
        for robot in ROBOTS:
            topic = Level(robot, STAMPED).topic(number)
            text = f'select point.x as level from "{topic}" with max_delay = {stated} ms{gap}'
            self._system.client.create(f'{robot}{number}_stated', text, MANAGER)
        self.descriptions[number] += f'stated: {stated} ms{gap}'
        return stated

    def _ask(self, number: int, stated: int) -> Question:
        chance = self._chance
        first, second = chance.sample(ROBOTS, 2)
        levels = [Level(each, chance.choices(KINDS, (60, 25, 15))[0]) for each in (first, second)]
        shape, is_stated = chance.choice(SHAPES), chance.random() < 0.5  # noqa: PLR2004
        topics = {each.reference(number, is_stated=is_stated): each for each in levels}
        text = shape.format(*topics)
        now = time.time_ns()
        begin = now + chance.randint(*BEGIN_MS) * MS
        max_delay = stated * MS if is_stated else None
        question = Question(number, text, topics, begin, max_delay, now)

        def end(done: Any) -> None:
            question.answered, question.answer = time.time_ns(), done.result()

        self._system.client.request(
            EvaluateFormula,
            EVALUATE,
            formula=text,
            grounding=EvaluateFormula.Request.SYNTACTIC,
            constraints=StreamConstraints(start_time=[nanoseconds_to_time(begin)]),
            timeout=Duration(sec=TIMEOUT_S),
        ).add_done_callback(end)
        return question


def _send(process: subprocess.Popen[str], episodes: Sequence[Episode]) -> None:
    if process.stdin is None:
        raise RuntimeError('a robot has no pipes')
    request = {'seconds': ROUND_S, 'episodes': [asdict(each) for each in episodes]}
    print(json.dumps(request), file=process.stdin, flush=True)


def _messages(robots: Iterable[Any]) -> dict[str, list[Message]]:
    """Wait for the end of a round, and return the messages of each topic."""
    return {
        topic: [Message(**each) for each in found]
        for robot in robots
        for topic, found in json.loads(robot.stdout.readline()).items()
    }


def report_of(rounds: Rounds) -> dict[str, Any]:
    """Return the outcomes and judgements, and the answers that are at fault."""
    counts = Counter(judgement for _, judgement in rounds.judged)
    return {
        'questions': len(rounds.judged),
        'episodes': len(rounds.descriptions),
        'outcomes': dict(sorted(Counter(each.outcome for each, _ in rounds.judged).items())),
        'judgements': {each: counts[each] for each in JUDGEMENTS},
        'faults': [
            f'{judgement}: {each.outcome}: {each.text} from {each.begin}; '
            f'{rounds.descriptions[each.number]}; {each.answer.exit_status.message}'
            f'{each.answer.explanation}'
            for each, judgement in rounds.judged
            if judgement in (WRONG, NOT_ALLOWED)
        ],
    }


def main() -> None:
    """Run and print; the exit code is 1 if an answer is wrong or an error not allowed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--questions', type=int, default=1000)
    parser.add_argument('--seed', type=int, default=1)
    parser.add_argument('--without-gaps', action='store_true', help='state no max_gap')
    parser.add_argument('--logs', type=Path, help='an existing folder for the logs of the nodes')
    parser.add_argument('--json', action='store_true', help='print one JSON object')
    arguments = parser.parse_args()
    use_private_domain()
    with ExitStack() as stack:
        robots = {each: stack.enter_context(worker(each, program=PROGRAM)) for each in ROBOTS}
        for each in robots.values():
            stack.callback(stop, each)
        system = stack.enter_context(RunningSystem(1, 2.0, logs=arguments.logs))
        chance = random.Random(arguments.seed)  # noqa: S311
        rounds = Rounds(system, robots, chance, states_gaps=not arguments.without_gaps)
        while len(rounds.judged) < arguments.questions:
            rounds.run()
            found = report_of(rounds)
            print(found['judgements'], file=sys.stderr, flush=True)
        codes = system.stop()
    found['exit_codes'] = codes
    print_report(found, as_json=arguments.json)
    raise SystemExit(bool(found['faults']))


if __name__ == '__main__':
    main()
