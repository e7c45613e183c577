"""The verdict of a formula for a peer: what the peer knows of it, and when."""

from __future__ import annotations

from test_peer import LEVEL, MS, Net

from dyknow_common import SECOND_NS, UNIX_TIMES, Alternatives, Verdict, format_time
from dyknow_coordinator import Answer, Progress
from dyknow_federation.events import FormulaWaits, StreamViolated, ValueKnown, WatermarkArrived
from dyknow_federation.messages import FormulaRequest
from dyknow_federation.own_verdict import EVALUATION_NS, OwnVerdict
from dyknow_federation.push_down import PRESUMABLY_FALSE, UNDECIDED

VERDICT = '_verdict_1'
CAUSE = 'its sensor has fallen silent'


class Evaluation:
    """`b` has asked `a` to evaluate a formula; the clock of `a` is ahead."""

    def __init__(self, offset: int = 3 * SECOND_NS, start: int = 100 * SECOND_NS) -> None:
        self.net = net = Net('a', 'b')
        net.now, net.offsets['a'] = start, offset
        net.peers['a'].share([], [LEVEL], net.time('a'))
        request = FormulaRequest(VERDICT, 'always level.value > 0')
        net.run(0.5)
        net.peers['b'].request_formula('a', request, net.time('b'))
        net.run(0.1)
        net.peers['b'].request('a', VERDICT, net.time('b'))
        net.run(0.5)
        self.verdict = OwnVerdict(net.peers['a'], VERDICT)
        self.states = 0

    @property
    def now(self) -> int:
        """By the clock of `a`."""
        return self.net.time('a')

    def run(self, seconds: float, *, has_samples: bool = True) -> None:
        """Time passes; the samples until now are known at `a`, if there are any."""
        last = self.now if self.states else None
        for _ in range(round(10 * seconds)):
            last = self.now if has_samples else last
            self.verdict.advance(last, self.now)
            self.net.run(0.1)

    def report(self, *, is_false: bool = False, waits_for: str = '', states: int = 1) -> None:
        """The engine reports, after further states until now."""
        self.states += states
        latest = self.now if self.states else 0
        self.verdict.note(
            Progress(self.states, latest, '', is_false, waits_for=waits_for), self.now
        )

    def known_until(self) -> int:
        """Until when `b` knows how the formula stands, by the clock of `a`; 0: never."""
        events = self.net.events['b']
        times = [each.time for each in events if isinstance(each, ValueKnown | WatermarkArrived)]
        has_value = any(isinstance(each, ValueKnown) for each in events)
        return max(times) + self.net.offsets['a'] if has_value else 0

    def told(self) -> list[str]:
        """The certain verdicts that `b` was told, each once."""
        found = [each for each in self.net.events['b'] if isinstance(each, ValueKnown)]
        values = [each.value for each in found if not isinstance(each.value, Alternatives)]
        return [*dict.fromkeys(map(str, values))]


def test_nothing_is_known_before_the_first_state() -> None:
    """Also if the samples of some of its streams come."""
    evaluation = Evaluation()
    evaluation.verdict.note(Progress(), evaluation.now)
    evaluation.run(5, has_samples=True)
    assert evaluation.known_until() == 0


def test_it_is_undecided_as_far_as_samples_are_known() -> None:
    evaluation = Evaluation()
    evaluation.report()
    evaluation.run(5)
    late = evaluation.now - evaluation.known_until()
    assert EVALUATION_NS <= late <= EVALUATION_NS + 200 * MS
    assert evaluation.told() == [UNDECIDED]


def test_a_silent_stream_ends_the_promise() -> None:
    """Repeats of the verdict, too: they would be states of the asking host."""
    evaluation = Evaluation()
    evaluation.report()
    evaluation.run(3)
    last = evaluation.now
    evaluation.run(30, has_samples=False)
    assert evaluation.known_until() <= last
    evaluation.run(1)
    assert evaluation.known_until() > last + 30 * SECOND_NS


def test_the_reason_of_a_wait_is_told_again_and_again() -> None:
    evaluation = Evaluation()
    until = evaluation.net.now + SECOND_NS // 2
    evaluation.net.drops = lambda _: evaluation.net.now < until
    evaluation.report()
    evaluation.report(waits_for=CAUSE, states=0)
    evaluation.run(5)
    found = evaluation.net.take('b', FormulaWaits)
    assert found[-1] == FormulaWaits('a', VERDICT, CAUSE)
    assert len(found) > 1
    evaluation.report()
    evaluation.run(1)
    evaluation.net.take('b', FormulaWaits)
    evaluation.run(3)
    assert not [each for each in evaluation.net.events['b'] if isinstance(each, FormulaWaits)]


def test_what_it_presumably_is_changes() -> None:
    evaluation = Evaluation()
    for is_false in (False, True, False):
        evaluation.report(is_false=is_false)
        evaluation.run(1)
    found = [each.value for each in evaluation.net.events['b'] if isinstance(each, ValueKnown)]
    certain = [each for each in found if not isinstance(each, Alternatives)]
    assert [*dict.fromkeys(certain)] == [UNDECIDED, PRESUMABLY_FALSE]
    assert certain[-1] == UNDECIDED


def test_a_verdict_is_known_since_the_state_that_has_decided_it() -> None:
    evaluation = Evaluation()
    evaluation.report()
    evaluation.run(3)
    decided = evaluation.now - EVALUATION_NS
    evaluation.verdict.decide(Answer(Verdict.FALSE, decided), 'it is low', evaluation.now)
    evaluation.run(1)
    assert evaluation.told() == [UNDECIDED, 'false: it is low']
    found = [each for each in evaluation.net.events['b'] if isinstance(each, ValueKnown)]
    at = next(each.time for each in found if each.value == 'false: it is low')
    assert 0 <= at + evaluation.net.offsets['a'] - decided <= 4 * MS
    assert evaluation.now - evaluation.known_until() <= 200 * MS


def test_a_first_state_may_decide_it() -> None:
    evaluation = Evaluation()
    decided = evaluation.now
    evaluation.verdict.decide(Answer(Verdict.TRUE, decided), '', evaluation.now)
    evaluation.run(1)
    assert evaluation.told() == ['true']


def test_after_a_failure_nothing_is_promised() -> None:
    evaluation = Evaluation()
    evaluation.report()
    evaluation.run(1)
    evaluation.verdict.fail(CAUSE, evaluation.now)
    failed = evaluation.now
    evaluation.verdict.fail('another reason', evaluation.now)
    evaluation.verdict.decide(Answer(Verdict.TRUE, evaluation.now), '', evaluation.now)
    evaluation.report()
    evaluation.run(5)
    [violation] = evaluation.net.take('b', StreamViolated)
    assert violation.reason == f"peer 'a' reports: {CAUSE}"
    assert evaluation.known_until() <= failed


def test_times_in_a_reason_are_of_the_clock_of_the_asking_host() -> None:
    offset = 3 * SECOND_NS
    evaluation = Evaluation(offset, start=UNIX_TIMES + 100 * SECOND_NS)
    decided = evaluation.now
    reason = f'X[r1] = 3.000 at {format_time(decided)} is not > 5'
    evaluation.verdict.decide(Answer(Verdict.FALSE, decided), reason, evaluation.now)
    evaluation.run(1)
    found = [each for each in evaluation.net.events['b'] if isinstance(each, ValueKnown)][-1]
    assert found.value == f'false: X[r1] = 3.000 at {format_time(found.time)} is not > 5'
    assert 0 <= found.time - (decided - offset) <= 4 * MS
