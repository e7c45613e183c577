"""A peer among others: joining, leaving, restarts, refusals, limits, jumps of clocks."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import Any

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from dyknow_common import NANOSECONDS, SECOND_NS, Alternatives, Value
from dyknow_configuration import RequestedFederation, RequestedShare
from dyknow_federation.encoding import VERSION, encode
from dyknow_federation.errors import FederationError
from dyknow_federation.events import (
    ClockJumped,
    FormulaAnswered,
    PeerEvent,
    PeerFault,
    PeerLeft,
    SharesChanged,
    StreamViolated,
    ValueKnown,
    WatermarkArrived,
)
from dyknow_federation.messages import (
    MAX_BATCH,
    FormulaReply,
    FormulaRequest,
    Hello,
    Message,
    Packet,
    Request,
    RequestRefusal,
    Samples,
    SharedFeature,
    StreamFault,
)
from dyknow_federation.peer import MAX_COMPARISONS, MAX_FORMULAS, Peer

MS = NANOSECONDS['ms']
LARGEST = sys.float_info.max
LEVEL = SharedFeature('Level', ('r1',), 'level', 'float')


class Net:
    """Hosts in simulated time, over links of 1 ms; the clock of each is `offsets` ahead."""

    def __init__(self, *names: str) -> None:
        self.now = 100 * SECOND_NS
        self.offsets = dict.fromkeys(names, 0)
        self.peers: dict[str, Peer] = {}
        self.events: dict[str, list[PeerEvent]] = {name: [] for name in names}
        self.drops: Callable[[Packet], bool] = lambda _: False
        self.alters: Callable[[bytes], bytes] = lambda data: data
        self._on_the_way: list[tuple[int, str, str, bytes]] = []
        for number, name in enumerate(names, 1):
            self.start(name, number)

    def start(self, name: str, incarnation: int, **settings: Any) -> None:
        self.offsets.setdefault(name, 0)
        self.events.setdefault(name, [])
        self.peers[name] = Peer(RequestedFederation(name, **settings), incarnation)

    def time(self, name: str) -> int:
        return self.now + self.offsets[name]

    def run(self, seconds: float) -> None:
        end = self.now + int(seconds * SECOND_NS)
        while self.now < end:
            for name, peer in self.peers.items():
                if peer.next_deadline() <= self.time(name):
                    self._act(name, *peer.advance(self.time(name)))
            self.now += MS
            arrived = [each for each in self._on_the_way if each[0] <= self.now]
            self._on_the_way = [each for each in self._on_the_way if each[0] > self.now]
            for _, name, sender, data in arrived:
                if name in self.peers:
                    self._act(name, *self.peers[name].receive(data, self.time(name), sender))

    def _act(self, name: str, packets: list[tuple[str, Packet]], events: list[PeerEvent]) -> None:
        self.events[name] += events
        for receiver, packet in packets:
            for other in self.peers:
                if other != name and receiver in {'', other} and not self.drops(packet):
                    data = self.alters(encode(packet))
                    self._on_the_way.append((self.now + MS, other, name, data))

    def take(self, name: str, kind: type[PeerEvent]) -> list[PeerEvent]:
        """The events of a kind so far; all events are forgotten."""
        found, self.events[name] = self.events[name], []
        return [each for each in found if isinstance(each, kind)]

    def send(self, receiver: str, sender: str, message: Message) -> list[PeerEvent]:
        peer = self.peers[receiver]
        return peer.receive(encode(Packet(7, (message,))), self.time(receiver), sender).events

    def publish(self, name: str, value: Value) -> None:
        self.peers[name].publish('level', self.time(name), value, self.time(name))

    def values(self, name: str) -> list[Value]:
        """The values that have become known, without those that are one of several."""
        known = [each.value for each in self.take(name, ValueKnown)]
        return [each for each in known if not isinstance(each, Alternatives)]

    def settle(self) -> None:
        """Run until it is known of `a` that no sample follows."""
        self.run(0.01)
        self.peers['a'].promise('level', self.time('a'), self.time('a'))
        self.run(0.1)

    def assert_known(self, value: float) -> None:
        """What `a` publishes now is known at `b` from the latest time on that is possible."""
        at = self.time('b')
        self.publish('a', value)
        self.settle()
        found = self.take('b', ValueKnown)[-1]
        assert found.value == value
        assert 0 <= found.time - at <= 4 * MS


def sharing(*others: str, offset: int = 0) -> Net:
    """`b` asks `a` for its level."""
    net = Net('a', 'b', *others)
    net.offsets['a'] = offset
    net.peers['a'].share([], [LEVEL], net.time('a'))
    net.peers['b'].request('a', 'level', net.time('b'))
    net.run(0.5)
    return net


def test_peers_find_each_other_and_share() -> None:
    net = sharing(offset=5 * SECOND_NS)
    kinds = [type(each) for each in net.events['b']]
    assert kinds == [SharesChanged]
    assert [*net.peers['a'].sent] == ['level']
    net.events['b'].clear()
    net.assert_known(1.5)
    net.publish('a', 2)
    net.run(0.1)
    found = net.take('b', ValueKnown)[-1].value
    assert found.values == (1.5, 2)
    assert found.reason.startswith('the clocks of b and a differ by 5')
    assert 'plus or minus 1.' in found.reason


def test_values_of_a_stream_with_a_deadband_are_intervals() -> None:
    net = Net('a', 'b')
    net.peers['a'].share([], [replace(LEVEL, deadband=0.5)], net.time('a'))
    net.peers['b'].request('a', 'level', net.time('b'))
    net.run(0.5)
    net.publish('a', 2)
    net.settle()
    found = net.take('b', ValueKnown)[-1].value
    assert found.is_interval
    assert found.values[0] == 2
    assert found.bounds == pytest.approx((1.5, 2.5))
    assert found.reason == 'a shares level with a deadband of 0.5'
    net.publish('a', 3)
    net.run(0.1)
    found = net.take('b', ValueKnown)[0].value
    assert found.bounds == pytest.approx((1.5, 3.5))
    assert found.reason.startswith('a shares level with a deadband of 0.5, and the clocks of b')
    net.settle()
    net.publish('a', True)
    net.settle()
    assert net.take('b', ValueKnown)[-1].value is True


def test_of_a_stream_that_is_compared_with_constants_crossings_are_sent() -> None:
    net = Net('a', 'b', 'c')
    net.peers['a'].share([], [LEVEL], net.time('a'))
    net.peers['b'].request('a', 'level', net.time('b'), constants=(2.0, 5.0))
    net.peers['c'].request('a', 'level', net.time('c'))
    net.run(0.5)
    assert [*net.peers['a'].sent] == ['level']
    for value in (3, 4, 5, 7, 6, math.inf):
        net.publish('a', value)
        net.settle()
    found = [each.value for each in net.take('b', ValueKnown)]
    known = [(each.bounds, each.reason) for each in found[::2] if isinstance(each, Alternatives)]
    between, above = (math.nextafter(2, 3), math.nextafter(5, 4)), (math.nextafter(5, 6), LARGEST)
    reason = 'b asks for level as compared with 2.0, 5.0 alone'
    assert known == [(between, reason), (above, reason)]
    assert (found[2], found[6]) == (5, math.inf)
    assert found[1].bounds == (between[0], 5)
    assert found[1].reason.startswith(f'{reason}, and the clocks of b and a differ by')
    assert net.values('c') == [3, 4, 5, 7, 6, math.inf]
    assert net.peers['a'].given('b') == net.peers['a'].given('c') == ['level']


def test_who_asks_anew_is_told_the_value_though_it_is_not_sent_again() -> None:
    net = Net('a', 'b')
    net.peers['a'].share([], [LEVEL], net.time('a'))
    for constants in ((2.0,), (2.0,), (), (5.0,)):
        asked = net.time('b')
        net.peers['b'].request('a', 'level', asked, after=asked, constants=constants)
        net.run(0.5)
        net.publish('a', 3)
        net.settle()
        assert net.take('b', ValueKnown)[-1].time > asked
        net.publish('a', 3)
        net.settle()
        assert bool(net.take('b', ValueKnown)) == (not constants)
        net.peers['b'].release('a', 'level')
        net.run(0.1)


def test_lists_of_constants_are_limited() -> None:
    net = Net('a', 'b')
    net.peers['a'].share([], [LEVEL], net.time('a'))
    found = []
    for number in range(MAX_COMPARISONS + 1):
        request = Packet(7, (Request('level', constants=(float(number),)),))
        effects = net.peers['a'].receive(encode(request), net.time('a'), 'b')
        found += [each for _, packet in effects.packets for each in packet.messages]
    assert [each for each in found if isinstance(each, RequestRefusal)] == found[-1:]
    assert f'more than {MAX_COMPARISONS} lists' in found[-1].reason
    with pytest.raises(FederationError, match='ascending numbers'):
        net.peers['b'].request('a', 'level', net.time('b'), constants=(2.0, 1.0))


def test_changed_shares_are_told() -> None:
    net = sharing()
    net.take('b', SharesChanged)
    net.peers['a'].share([], [], net.time('a'))
    net.run(1.5)
    (changed,) = net.take('b', SharesChanged)
    assert changed.shares.features == ()
    assert net.peers['a'].sent == {}


def test_what_is_not_shared_is_refused_once() -> None:
    net = Net('a', 'b')
    net.peers['b'].request('a', 'secret', net.time('b'))
    net.run(3)
    (refused,) = net.take('b', StreamViolated)
    assert refused.reason == "peer 'a' refuses it: it is not shared; name it in share there"
    net.peers['a'].share([], [SharedFeature('S', (), 'secret', 'float')], net.time('a'))
    net.run(3)
    assert [*net.peers['a'].sent] == ['secret']


def test_what_is_shared_is_not_refused_after_a_restart() -> None:
    """A host finds out what it can share some time after it has begun."""
    net = sharing()
    net.start('a', 7, share=(RequestedShare('level'),))
    net.run(3)
    reasons = [each.reason for each in net.take('b', StreamViolated)]
    assert reasons == ["samples of peer 'a' are lost: the peer has started again"]
    assert net.peers['b'].remotes['a'].shares.features == (LEVEL,)
    net.peers['a'].share([], [LEVEL], net.time('a'))
    net.run(0.5)
    net.publish('a', 4)
    net.settle()
    assert net.values('b')[-1] == 4
    assert not net.take('b', StreamViolated)


def test_a_formula_is_not_refused_by_a_host_that_has_just_begun() -> None:
    net = sharing()
    net.start('a', 7, share=(RequestedShare('level'),))
    net.peers['b'].request_formula('a', ASKED, net.time('b'))
    net.run(2)
    net.peers['a'].share([], [LEVEL], net.time('a'))
    net.run(1)
    (answered,) = net.take('b', FormulaAnswered)
    assert not answered.refusal


def test_why_a_stream_is_refused_that_a_host_has_named() -> None:
    net = Net('b')
    net.start('a', 7, share=(RequestedShare('level'),))
    net.peers['b'].request('a', 'level', net.time('b'))
    net.run(9)
    assert not net.take('b', StreamViolated)
    net.run(3)
    (refused,) = net.take('b', StreamViolated)
    assert refused.reason.startswith(
        "peer 'a' refuses it: it is not known there what can be shared"
    )
    net.peers['a'].share([], [], net.time('a'))
    net.run(3)
    (refused,) = net.take('b', StreamViolated)
    assert refused.reason == "peer 'a' refuses it: no stream there carries it now"


def test_a_violation_is_told_though_nothing_follows() -> None:
    net = sharing(offset=5 * SECOND_NS)
    net.publish('a', 1)
    net.run(0.01)
    net.publish('a', 2)
    fault = StreamFault(net.time('a'), 'max_gap', 'no sample for 2 s')
    net.drops = lambda _: True
    net.peers['a'].violate('level', fault, net.time('a'))
    at = net.now
    net.run(0.5)
    net.drops = lambda _: False
    net.run(2)
    told = [each.value for each in net.events['b'] if isinstance(each, ValueKnown)]
    assert told[-1].values == (1, 2)
    assert type(net.events['b'][-1]) is StreamViolated
    (told,) = net.take('b', StreamViolated)
    assert (told.peer, told.stream) == ('a', 'level')
    assert told.constraint == 'max_gap'
    assert told.reason == "peer 'a' reports: no sample for 2 s"
    assert at - 4 * MS <= told.valid_time <= at
    # Who asks later does not wait for what has failed.
    net.peers['b'].release('a', 'level')
    net.peers['b'].request('a', 'level', net.time('b'))
    net.run(1)
    assert net.take('b', StreamViolated)
    net.publish('a', 3)
    net.peers['b'].release('a', 'level')
    net.peers['b'].request('a', 'level', net.time('b'))
    net.run(1)
    assert not net.take('b', StreamViolated)


def test_a_stale_link_is_told_and_missed_samples_follow() -> None:
    net = sharing()
    net.publish('a', 1)
    net.settle()
    net.drops = lambda _: True
    for value in range(2, 10):
        net.run(1)
        net.publish('a', value)
    assert net.peers['b'].remotes['a'].is_stale
    assert net.values('b') == [1]
    net.drops = lambda _: False
    net.settle()
    net.run(2)
    assert not net.peers['b'].remotes['a'].is_stale
    assert net.values('b') == list(range(2, 10))


def test_a_peer_that_left_and_returns_sends_what_was_missed() -> None:
    net = sharing()
    net.publish('a', 1)
    net.settle()
    net.drops = lambda _: True
    for value in range(2, 42):
        net.run(1)
        net.publish('a', value)
    (left,) = net.take('b', PeerLeft)
    assert left.reason == "peer 'a' has not been heard for 10 s"
    net.drops = lambda _: False
    net.settle()
    net.run(3)
    assert net.values('b') == list(range(2, 42))


def test_what_a_peer_shared_is_forgotten_once_nothing_of_it_is_asked_for() -> None:
    """Formulas that look for another source name its objects until then."""
    net = sharing()
    net.drops = lambda _: True
    net.run(60)
    remote = net.peers['b'].remotes['a']
    (left,) = net.take('b', PeerLeft)
    assert remote.departure == left.reason
    assert remote.shares.features == (LEVEL,)
    net.peers['b'].release('a', 'level')
    net.run(8)
    assert not net.take('b', SharesChanged)
    net.run(4)
    (changed,) = net.take('b', SharesChanged)
    assert (changed.peer, changed.shares.features) == ('a', ())
    assert net.peers['b'].remotes == {}
    net.drops = lambda _: False
    net.run(2)
    assert net.peers['b'].remotes['a'].departure == ''
    assert net.take('b', SharesChanged)[-1].shares.features == (LEVEL,)


def test_a_restart_loses_what_was_not_sent() -> None:
    net = sharing()
    net.publish('a', 1)
    net.run(0.1)
    net.events['b'].clear()
    net.offsets['a'] = -SECOND_NS
    net.start('a', 77)
    net.peers['a'].share([], [LEVEL], net.time('a'))
    net.run(2)
    assert [type(each) for each in net.events['b']] == [StreamViolated, SharesChanged]
    net.assert_known(2)
    # A late packet of the former run changes nothing.
    late = encode(Packet(1, (Samples(1, 2, (1,), (5.0,)),)))
    assert net.peers['b'].receive(late, net.time('b'), 'a') == ([], [])


@given(st.integers(0, 30), st.floats(0, 1, exclude_max=True), st.integers(1, 255))
@example(8, 0.625, 8)
@settings(max_examples=30)
def test_after_an_altered_packet_all_goes_on(number: int, part: float, difference: int) -> None:
    net = sharing()
    numbers = count()

    def alters(data: bytes) -> bytes:
        place = int(part * len(data))
        is_altered = next(numbers) == number
        altered = data[:place] + bytes([data[place] ^ difference]) + data[place + 1 :]
        return altered if is_altered else data

    net.alters = alters
    for value in range(8):
        net.publish('a', value)
        net.run(0.5)
    net.peers['a'].share([], [LEVEL, SharedFeature('S', (), 's', 'float')], net.time('a'))
    net.run(4)
    net.assert_known(99)
    assert len(net.peers['b'].remotes['a'].shares.features) == 2


def test_a_run_that_was_never_there_does_not_stay() -> None:
    net = sharing()
    net.publish('a', 1)
    net.settle()
    net.send('b', 'a', Hello(1))  # Of run 7.
    net.run(1)
    remote = net.peers['b'].remotes['a']
    assert remote.late > 0
    assert remote.fault == f'{remote.late} packets of a former run of the peer are dropped'
    net.run(5)
    assert not remote.is_stale
    net.assert_known(2)


def test_a_restart_is_told_while_the_clock_is_not_known() -> None:
    net = sharing()
    net.publish('a', 1)
    net.run(0.1)
    net.events['b'].clear()
    net.offsets['b'] -= SECOND_NS
    net.drops = lambda packet: not isinstance(packet.messages[0], Hello)
    net.start('a', 77)
    net.run(2)
    (lost,) = net.take('b', StreamViolated)
    assert (lost.constraint, lost.valid_time) == ('lost', None)
    assert lost.reason == "samples of peer 'a' are lost: the peer has started again"


def test_peers_of_another_version_are_named_once() -> None:
    net = Net('b')
    packets = [net.peers['b'].receive(bytes([VERSION - 1]), net.now, 'old') for _ in range(3)]
    (fault,) = [event for each in packets for event in each.events]
    assert isinstance(fault, PeerFault)
    assert fault.peer == 'old'
    assert 'install the same version' in fault.message


def test_bad_packets_and_doubled_names_are_faults() -> None:
    net = Net('b')
    (fault,) = net.peers['b'].receive(b'nonsense', net.now, 'x').events
    assert fault == PeerFault('x', f'a message is refused: {fault.message.partition(": ")[2]}')
    net.run(30)
    (fault,) = net.send('b', 'b', Hello(1))
    assert 'give each host its own name' in fault.message
    with pytest.raises(FederationError, match='needs a name'):
        Peer(RequestedFederation(''), 1)


def test_faults_of_senders_that_are_no_peers_are_reported_as_those_of_one() -> None:
    net = sharing()
    received = net.peers['b'].remotes['a'].received
    assert received > 0
    bad = [net.peers['b'].receive(b'?', net.time('b'), f'p{number}') for number in range(3000)]
    bad += [net.peers['b'].receive(b'?', net.time('b'), 'a') for _ in range(2)]
    assert [each.peer for effects in bad for each in effects.events] == ['p0', 'a']
    assert 'version 63' in net.peers['b'].remotes['a'].fault
    assert net.peers['b'].remotes['a'].received == received + 2
    assert [*net.peers['b'].remotes] == ['a']


def test_what_peers_make_us_keep_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr('dyknow_federation.peer.MAX_PEERS', 20)
    net = Net('b')
    for number in range(20):
        net.send('b', f'p{number}', Hello(1))
    (fault,) = net.send('b', 'one more', Hello(1))
    assert 'more than 20 peers' in fault.message
    # What is read here of a peer that was forgotten is asked of it, as ever.
    net.peers['b'].request('forgotten', 'level', net.now)
    net.send('b', 'forgotten', Hello(1))
    assert net.peers['b'].remotes['forgotten'].is_present
    net.peers['b'].release('forgotten', 'level')
    net.peers['b'].share([], [LEVEL], net.now)
    net.send('b', 'p1', Request('level'))
    net.send('b', 'p1', Request('never shared'))
    assert [*net.peers['b'].sent] == ['level']
    times = tuple(range(MAX_BATCH))
    net.send('b', 'p1', Samples(9, 1, times, times))
    net.run(30)
    assert net.peers['b'].remotes == {}
    net.run(80)
    assert net.peers['b'].sent == {}


def test_a_jump_of_a_clock_is_told() -> None:
    net = sharing()
    net.publish('a', 1)
    net.run(2)
    net.events['b'].clear()
    net.offsets['a'] += 2 * SECOND_NS
    net.run(2)
    jumps = [each for each in net.events['b'] if isinstance(each, ClockJumped)]
    assert jumps
    assert jumps[0].since is not None
    assert net.now - jumps[0].since < 4 * SECOND_NS
    net.events['b'].clear()
    net.assert_known(2)


def test_a_clock_that_jumps_ahead_promises_nothing_that_is_still_to_come() -> None:
    """Until the jump is noticed, a state ahead of the clock would be taken for certain."""
    net = sharing()
    net.assert_known(1)
    net.events['b'].clear()
    net.drops = lambda packet: packet.is_urgent
    net.offsets['a'] += 5 * SECOND_NS
    net.peers['a'].promise('level', net.time('a'), net.time('a'))
    net.run(0.1)
    (promise,) = net.take('b', WatermarkArrived)
    assert promise.time <= net.time('b')


@pytest.mark.parametrize(('lead', 'is_lost'), [(50 * MS, False), (5 * SECOND_NS, True)])
def test_samples_ahead_of_the_clock_count_as_at_the_engines(lead: int, is_lost: bool) -> None:  # noqa: FBT001
    net = sharing(offset=7 * SECOND_NS)
    at = net.time('a')
    net.peers['a'].publish('level', at + lead, 1, at)
    net.run(0.1)
    assert any('still to come' in each.reason for each in net.take('b', StreamViolated)) == is_lost
    net.settle()
    assert net.values('b') == ([] if is_lost else [1])


@pytest.mark.parametrize(
    ('value', 'reason'),
    [
        ('ü' * 5001, 'it has 10,002 bytes; peers get at most 10,000'),
        (2**63, 'an integer has more than 64 bits'),
    ],
)
def test_a_value_that_cannot_cross_is_a_violation(value: Value, reason: str) -> None:
    net = sharing()
    net.publish('a', value)
    net.settle()
    (violation,) = net.take('b', StreamViolated)
    assert violation.constraint == 'fields'
    assert violation.reason == f"peer 'a' reports: a value of 'level' cannot cross: {reason}"
    net.assert_known(2)


def test_an_own_clock_that_jumps_back_stops_nothing() -> None:
    net = sharing(offset=1000 * SECOND_NS)
    net.publish('a', 1)
    net.settle()
    assert net.values('b') == [1]
    net.offsets['a'] = 0
    net.run(2)
    assert net.take('a', ClockJumped)
    net.assert_known(2)


def test_samples_are_published_in_order() -> None:
    net = sharing()
    peer, now = net.peers['a'], net.time('a')
    peer.promise('level', now, now)
    with pytest.raises(FederationError, match='as was promised'):
        peer.publish('level', now, 1, now)


def test_a_released_stream_is_sent_no_more() -> None:
    net = sharing()
    net.peers['b'].release('a', 'level')
    net.run(0.1)
    assert not net.peers['a'].sent['level'][()].subscribers


def test_an_old_value_is_no_alternative_after_a_pause() -> None:
    """What was valid while nobody asked is not known, so what was valid before does not count."""
    net = sharing()
    net.assert_known(1)
    told = net.time('b')
    net.peers['b'].release('a', 'level')
    for value in (2, 3):
        net.run(0.5)
        net.publish('a', value)
    net.run(0.5)
    net.peers['b'].request('a', 'level', net.time('b'), told)
    net.run(0.2)
    net.publish('a', 4)
    net.settle()
    known = net.take('b', ValueKnown)
    values = [each.value for each in known]
    assert [getattr(each, 'values', each) for each in values] == [3, (3, 4), 4]
    assert all(each.time > told for each in known)


ASKED = FormulaRequest('_b_1', 'always level.value > 3', 100 * MS)


def has(packet: Packet, kind: type[Message]) -> bool:
    return any(isinstance(each, kind) for each in packet.messages)


def ask_formula(net: Net, request: FormulaRequest = ASKED, asker: str = 'b') -> list[PeerEvent]:
    """Ask `a` to evaluate a formula; return what becomes of it."""
    net.peers[asker].request_formula('a', request, net.time(asker))
    net.run(3)
    return net.take(asker, FormulaAnswered)


def test_the_verdict_of_a_formula_crosses_like_a_stream() -> None:
    net = sharing()
    assert ask_formula(net) == [FormulaAnswered('a', '_b_1', '')]
    a, b = net.peers['a'], net.peers['b']
    assert a.formulas['_b_1'].streams == {'level'}
    assert '_b_1' not in a.sent
    b.request('a', '_b_1', net.time('b'))
    net.run(0.5)
    assert a.given('b') == ['_b_1', 'level']
    a.publish('_b_1', net.time('a'), 'undecided', net.time('a'))
    net.run(20)
    assert a.formulas, 'the subscription is repeated'
    a.publish('_b_1', net.time('a'), 'true: so', net.time('a'))
    net.run(0.1)
    a.promise('_b_1', net.time('a'), net.time('a'))
    net.run(0.5)
    assert net.values('b')[-1] == 'true: so'
    b.release('a', '_b_1')
    net.run(0.5)
    assert not a.formulas
    assert '_b_1' not in a.sent


def test_a_formula_is_asked_for_again_until_it_is_answered() -> None:
    net = sharing()
    losses = iter([True] * 3)
    net.drops = lambda packet: has(packet, FormulaRequest) and next(losses, False)
    assert ask_formula(net) == [FormulaAnswered('a', '_b_1', '')]


def test_a_formula_that_nobody_answers_is_given_up() -> None:
    net = sharing()
    net.drops = lambda packet: has(packet, FormulaReply)
    assert ask_formula(net) == []
    net.run(3)
    (answer,) = net.take('b', FormulaAnswered)
    assert answer == FormulaAnswered('a', '_b_1', 'it does not answer within 5 s')
    net.run(15)
    assert not net.peers['a'].formulas, 'its verdict was not requested'
    del net.peers['a']
    net.run(20)
    net.take('b', FormulaAnswered)
    assert ask_formula(net) == [answer]


def test_a_formula_is_given_up_though_its_peer_is_forgotten_before() -> None:
    net = Net('b', 'a')
    net.peers['b'] = Peer(RequestedFederation('b', peer_timeout=SECOND_NS), 3)
    net.run(1)
    del net.peers['a']
    net.peers['b'].request_formula('a', ASKED, net.time('b'))
    net.run(7)
    assert net.take('b', FormulaAnswered)
    assert not net.peers['b'].remotes


def test_a_formula_is_given_up_though_the_own_clock_jumps_back() -> None:
    net = sharing()
    net.drops = lambda packet: has(packet, FormulaReply)
    assert ask_formula(net) == []
    net.offsets['b'] -= 1000 * SECOND_NS
    net.run(6)
    assert net.take('b', FormulaAnswered)


@pytest.mark.parametrize(
    ('request_', 'refusal'),
    [
        (replace(ASKED, formula='always other.value > 3'), "'other' is not shared; name it in"),
        (replace(ASKED, formula='always'), "'always' is no formula here"),
        (replace(ASKED, stream='_c_1'), "'_c_1' is the verdict of another peer"),
    ],
)
def test_a_formula_that_is_refused(request_: FormulaRequest, refusal: str) -> None:
    net = sharing('c')
    ask_formula(net, replace(ASKED, stream='_c_1'), 'c')
    (answer,) = ask_formula(net, request_)
    assert isinstance(answer, FormulaAnswered)
    assert answer.refusal.startswith(refusal)


def test_the_number_of_formulas_is_limited() -> None:
    net = sharing()
    for number in range(MAX_FORMULAS + 1):
        request = replace(ASKED, stream=f'_b_{number}')
        net.peers['b'].request_formula('a', request, net.time('b'))
    net.run(3)
    refusals = [each.refusal for each in net.take('b', FormulaAnswered)]
    assert [each for each in refusals if each] == [
        f'{MAX_FORMULAS} formulas are evaluated for peers; end some'
    ]


def test_only_who_asked_reads_and_ends_a_verdict() -> None:
    net = sharing('c')
    ask_formula(net)
    net.peers['c'].request('a', '_b_1', net.time('c'))
    net.run(1)
    (violation,) = net.take('c', StreamViolated)
    assert 'it is not shared' in violation.reason
    net.peers['c'].release('a', '_b_1')
    net.run(1)
    assert '_b_1' in net.peers['a'].formulas


def test_a_formula_ends_with_the_share_of_a_stream_of_it() -> None:
    net = sharing()
    ask_formula(net)
    net.peers['b'].request('a', '_b_1', net.time('b'))
    net.run(1)
    net.peers['a'].share((), (), net.time('a'))
    net.run(2)
    assert not net.peers['a'].formulas
    violations = net.take('b', StreamViolated)
    assert {each.stream for each in violations} == {'level', '_b_1'}
    assert all('it is not shared' in each.reason for each in violations)


@pytest.mark.parametrize('wrong', [{'stream': 'level'}, {'sample_period': -1}])
def test_a_request_for_a_formula_is_checked(wrong: dict[str, object]) -> None:
    with pytest.raises(FederationError, match='names no verdict, or its period is negative'):
        replace(ASKED, **wrong)
