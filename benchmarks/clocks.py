"""Verdicts over two robots whose clocks are off, judged by the true times of their values.

python benchmarks/clocks.py [--questions 1000] [--seed 1] [--without-gaps] [--logs FOLDER] [--json]

Two robots publish levels that are high or low. In each *episode*, the clock of a robot is off by -5
to 5 s, often by nothing or by less than 100 ms, and its stamped messages come 0 to 1.5 s after the
true times, with jitter. Some robots stall: once, no stamped message leaves them for up to 1.5 s.
Other topics have no stamps, or leave them at zero: their values hold from the time at which they
are sent. All questions about an episode are asked at the same time, over the topics, or over
streams that state a `max_delay`.

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
import random
import sys
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from threading import Thread
from typing import Any

from clock_judgement import (
    JUDGEMENTS,
    MAX_DELAY_NS,
    MAX_LEAD_NS,
    NOT_ALLOWED,
    WRONG,
    Judge,
    Question,
)
from clock_robots import KINDS, MS, STAMPED, Clock, Topic, publish
from dyknow_interfaces.msg import StreamConstraints
from dyknow_interfaces.srv import EvaluateFormula, StreamDestroy
from parts import print_report
from processes import MANAGER, use_private_domain
from running_system import RunningSystem

from dyknow_common.ros import nanoseconds_to_time

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
SETTING_UP_NS = 100 * MS

SHAPES = (
    'always[0 s, 1500 ms] not ({0} > 0.5 and {1} > 0.5)',
    'eventually[0 s, 1 s] ({0} > 0.5 and {1} > 0.5)',
    'always[0 s, 1 s] ({0} > 0.5 -> eventually[0 s, 800 ms] {1} > 0.5)',
    '(not {0} > 0.5) until[0 s, 1500 ms] {1} > 0.5',
    'eventually[0 s, 1 s] always[0 s, 500 ms] not ({0} > 0.5 and not {1} > 0.5)',
)
"""Formulas, with placeholders for the levels of two robots."""


class Episode:
    """Two robots, whose clocks differ, and the constraints that streams of their topics state.

    Args:
        number: of the episode.
        chance: of all that happens.
        begin: nanoseconds.
        end: nanoseconds.
        states_gaps: True if streams of robots that stall state a `max_gap`.
    """

    def __init__(
        self, number: int, chance: random.Random, begin: int, end: int, *, states_gaps: bool
    ) -> None:
        self.number = number
        self.topics = {
            (robot, kind): Topic(robot, number, kind) for robot in ROBOTS for kind in KINDS
        }
        self.max_delay_ms = chance.choice(STATED_MS)
        clocks = {robot: _clock(chance) for robot in ROBOTS}
        for each in self.topics.values():
            each.draw(clocks[each.robot], begin, end, chance)
        stalls = any(each.stall for each in clocks.values())
        gap = ', max_gap = 200 ms' if stalls and states_gaps else ''
        self.constraints = f'max_delay = {self.max_delay_ms} ms{gap}'
        self.description = f'{clocks}, stated: {self.constraints}'

    def streams(self) -> dict[str, str]:
        """Return the specifications of the streams, by name."""
        return {
            f'{each.robot}{self.number}_stated': f'select point.x as level from "{each.name}" '
            f'with {self.constraints}'
            for each in self.topics.values()
            if each.kind == STAMPED
        }

    def question(self, chance: random.Random) -> Question:
        """Return a random question, asked now."""
        topics = [
            self.topics[robot, chance.choices(KINDS, (60, 25, 15))[0]]
            for robot in chance.sample(ROBOTS, 2)
        ]
        is_stated = chance.random() < 0.5  # noqa: PLR2004
        levels = {each.reference(is_stated=is_stated): each for each in topics}
        text = chance.choice(SHAPES).format(*levels)
        now = time.time_ns()
        begin = now + chance.randint(*BEGIN_MS) * MS
        limit = self.max_delay_ms * MS if is_stated else MAX_DELAY_NS
        return Question(text, levels, begin, limit, now, self.description)


def _clock(chance: random.Random) -> Clock:
    """Return a clock; in some episodes, its offset is near a limit."""
    delay = chance.randint(0, chance.choice((20, 20, 400, 800, 1300)))
    jitter = chance.randint(0, chance.choice((50, 200)))
    limit = chance.choice((-MAX_LEAD_NS // MS, MAX_DELAY_NS // MS, *STATED_MS))
    most = chance.choice((0, 0, 0, 100, 100, 100, 100, 1500, 5000, None))
    if most is None:
        offset = delay + chance.randint(0, jitter) - limit
    else:
        offset = chance.randint(-most, most)
    return Clock(offset, delay, jitter, chance.choice((0, 0, chance.randint(100, 1500))))


def judged_round(
    system: RunningSystem, first: int, chance: random.Random, *, states_gaps: bool
) -> list[tuple[Question, str]]:
    """Have the robots perform episodes, ask about them, and return the judgements."""
    client, begin = system.client, time.time_ns() + SETTING_UP_NS
    end = begin + round(ROUND_S * 1e9)
    episodes = [
        Episode(first + each, chance, begin, end, states_gaps=states_gaps)
        for each in range(EPISODES)
    ]
    topics = [topic for each in episodes for topic in each.topics.values()]
    streams = {name: text for each in episodes for name, text in each.streams().items()}
    for each in topics:
        each.advertise(client.node)
    publisher = Thread(target=publish, args=(topics, end), daemon=True)
    publisher.start()
    for name, text in streams.items():
        client.create(name, text, MANAGER)
    client.wait(begin / 1e9 + ASKED_AFTER_S - time.time())
    asked = [each.question(chance) for each in episodes for _ in range(QUESTIONS)]
    for each in asked:
        _send(system, each)
    client.spin_until(lambda: all(each.answer for each in asked), 'the answers', ANSWER_LIMIT_S)
    client.spin_until(lambda: not publisher.is_alive(), 'the end of the round')
    for name in streams:
        client.call(StreamDestroy, f'{MANAGER}/stream_destroy', stream_name=name)
    for each in topics:
        each.close(client.node)
    return [(each, Judge(each).judgement()) for each in asked]


def _send(system: RunningSystem, question: Question) -> None:
    def end(done: Any) -> None:
        question.answered, question.answer = time.time_ns(), done.result()

    system.ask(
        question.text,
        TIMEOUT_S,
        grounding=EvaluateFormula.Request.SYNTACTIC,
        constraints=StreamConstraints(start_time=[nanoseconds_to_time(question.begin)]),
    ).add_done_callback(end)


def report_of(judged: Sequence[tuple[Question, str]]) -> dict[str, Any]:
    """Return the outcomes and judgements, and the answers that are at fault."""
    counts = Counter(judgement for _, judgement in judged)
    return {
        'questions': len(judged),
        'outcomes': dict(sorted(Counter(each.outcome for each, _ in judged).items())),
        'judgements': {each: counts[each] for each in JUDGEMENTS},
        'faults': [
            f'{judgement}: {each.outcome}: {each.text} from {each.begin}; {each.episode}; '
            f'{each.answer.exit_status.message}{each.answer.explanation}'
            for each, judgement in judged
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
    chance = random.Random(arguments.seed)  # noqa: S311
    judged: list[tuple[Question, str]] = []
    with RunningSystem(1, 2.0, logs=arguments.logs) as system:
        while len(judged) < arguments.questions:
            states_gaps = not arguments.without_gaps
            judged += judged_round(system, len(judged), chance, states_gaps=states_gaps)
            found = report_of(judged)
            print(found['judgements'], file=sys.stderr, flush=True)
        codes = system.launcher.stop_all()
    found['exit_codes'] = codes
    print_report(found, as_json=arguments.json)
    raise SystemExit(bool(found['faults']))


if __name__ == '__main__':
    main()
