"""Messages between peers. All times are in nanoseconds of the sender's clock."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from math import inf
from typing import Annotated, Final

from dyknow_common import Value, check_name, shortened
from dyknow_configuration import MAX_COMPARED, MAX_COMPARED_NUMBER
from dyknow_federation.errors import FederationError

MAX_BATCH: Final = 100
"""The number of samples of a batch: a packet has room for the longest ones."""

MAX_REASON: Final = 1_000
"""The length of the description of a violation; longer ones are cut."""

MAX_RANGES: Final = 20
"""The number of ranges of missing samples that a request names; later requests name others."""

Time = Annotated[int, 'nanoseconds']
"""A time of the clock of the sender."""


@dataclass(frozen=True, slots=True)
class Hello:
    """A sign of life of a peer, sent to all."""

    shares_version: int
    """A peer that knows an earlier version of its shares asks for them."""


@dataclass(frozen=True, slots=True)
class SharesRequest:
    """A request for the shares of a peer."""


@dataclass(frozen=True, slots=True)
class SharedObject:
    """An object that a peer knows, by its name there, with the sorts that it belongs to."""

    name: str
    sorts: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class SharedFeature:
    """A feature that a peer lets others ask for.

    Args:
        name: the feature in the ontology.
        objects: the objects that the feature is about.
        stream: the stream that carries it; requests name it.
        value_type: the type of its values, in the stream language.
        unit: the unit of its values; empty for none.
        deadband: how much its values may differ from the last sample that was sent.
    """

    name: str
    objects: tuple[str, ...]
    stream: str
    value_type: str
    unit: str = ''
    deadband: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.deadband < inf:
            raise FederationError(f'a deadband of {self.deadband} is no number from 0 on')


@dataclass(frozen=True, slots=True)
class Shares:
    """All that a peer shares; the version increases with each change."""

    version: int
    objects: tuple[SharedObject, ...] = ()
    features: tuple[SharedFeature, ...] = ()


@dataclass(frozen=True, slots=True)
class Request:
    """A request for a stream: it subscribes, acknowledges, and asks for what is missing.

    It is repeated while the stream is needed; a peer ends subscriptions that are not repeated.

    Args:
        stream: the name of the stream.
        epoch: the epoch of the numbers below; 0 if no sample has been received yet.
        number: all samples before this number have been received, or are lost.
        missing: the first and the last number of each missing range after `number`.
        constants: the numbers that values are compared with, ascending. A sample is sent only if a
            comparison has changed; without constants, all samples are sent.
    """

    stream: str
    epoch: int = 0
    number: int = 0
    missing: tuple[tuple[int, int], ...] = ()
    constants: tuple[float, ...] = ()

    def __post_init__(self) -> None:
        if len(self.missing) > MAX_RANGES:
            raise FederationError(f'{len(self.missing)} ranges are missing; name {MAX_RANGES}')
        are_small = all(abs(each) < MAX_COMPARED_NUMBER for each in self.constants)
        do_increase = all(less < greater for less, greater in pairwise(self.constants))
        if len(self.constants) > MAX_COMPARED or not (are_small and do_increase):
            raise FederationError(
                f'{shortened(str(self.constants))} are not at most {MAX_COMPARED} ascending '
                'numbers, each less than 2**53'
            )


@dataclass(frozen=True, slots=True)
class Release:
    """The end of a request."""

    stream: str


@dataclass(frozen=True, slots=True)
class RequestRefusal:
    """The answer to a request that is not granted, with the reason and the remedy."""

    stream: str
    reason: str


@dataclass(frozen=True, slots=True)
class FormulaRequest:
    """A request to evaluate a formula over streams that are shared; see `push_down`.

    It is repeated until it is answered. The evaluation begins with the request for the stream of
    the verdict, and ends with its release.

    Args:
        stream: the stream of the verdict; only such names begin with an underscore.
        formula: the formula over the names of streams, `always Charge_r1.value > 0.2`.
        sample_period: the period of its states, in nanoseconds; 0: every change is a state.
    """

    stream: str
    formula: str
    sample_period: int = 0

    def __post_init__(self) -> None:
        check_name(self.stream, FederationError)
        if not is_verdict(self.stream) or self.sample_period < 0:
            raise FederationError(f"'{self.stream}' names no verdict, or its period is negative")


@dataclass(frozen=True, slots=True)
class FormulaReply:
    """The answer to a request to evaluate a formula: why not; empty if it will be evaluated."""

    stream: str
    refusal: str


@dataclass(frozen=True, slots=True)
class FormulaWait:
    """The reason why a formula that a peer evaluates has no state; valid until the next verdict.

    Args:
        stream: the stream of the verdict.
        reason: the reason, for users.
    """

    stream: str
    reason: str


@dataclass(frozen=True, slots=True)
class Grant:
    """The answer to a request that does not know the epoch of the stream yet.

    Args:
        stream: its name.
        epoch: the epoch of the numbers from now on; numbers of different epochs are unrelated. No
            other stream of this run of the peer has this epoch.
        constants: the constants of the request.
    """

    stream: str
    epoch: int
    constants: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True)
class StreamFault:
    """A violation of a stream, as its host has noticed it.

    Args:
        valid_time: the valid time from which samples are in doubt.
        constraint: its kind, such as `max_gap`.
        reason: the description for users.
    """

    valid_time: Time
    constraint: str
    reason: str

    def __post_init__(self) -> None:
        check_name(self.constraint, FederationError)
        if len(self.reason) > MAX_REASON:
            raise FederationError(f'a reason has {len(self.reason)} characters; cut it')


def is_verdict(stream: str) -> bool:
    """Return True for the name of a stream of the verdicts of a formula; no shared one is like."""
    return stream.startswith('_')


Content = Value | StreamFault
"""What a number of a stream stands for: the value of a sample, or a violation."""


@dataclass(frozen=True, slots=True)
class Samples:
    """Samples of a stream, and its violations, with consecutive numbers.

    Args:
        epoch: the epoch of the numbers, which identifies the stream: see `Grant`.
        first: the number of the first sample or violation.
        valid_times: a time for each, in the clock of the sender; samples increase strictly.
        contents: the content of each.
    """

    epoch: int
    first: int
    valid_times: tuple[Time, ...]
    contents: tuple[Content, ...]

    def __post_init__(self) -> None:
        count = len(self.valid_times)
        if not 0 < count <= MAX_BATCH:
            raise FederationError(f'a batch has {count} samples; send 1 to {MAX_BATCH}')
        if len(self.contents) != count:
            raise FederationError(f'a batch has {count} samples, but {len(self.contents)} values')
        rows = zip(self.valid_times, self.contents, strict=True)
        times = [time for time, each in rows if not isinstance(each, StreamFault)]
        if any(later <= former for former, later in pairwise(times)):
            raise FederationError('the valid times of a batch do not increase')
        _check_numbers(self.epoch, self.first)


@dataclass(frozen=True, slots=True)
class Watermark:
    """A promise: all samples from a number on are valid later than a time."""

    epoch: int
    number: int
    oldest: int
    """The least number that can still be asked for; earlier ones are lost."""
    time: Time

    def __post_init__(self) -> None:
        _check_numbers(self.epoch, self.number)


@dataclass(frozen=True, slots=True)
class Probe:
    """The first half of an exchange that measures a clock."""

    sent_at: Time


@dataclass(frozen=True, slots=True)
class ProbeReply:
    """The second half of an exchange that measures a clock."""

    probe_sent_at: Time
    """As in the probe, in the clock of its sender."""
    received_at: Time
    sent_at: Time


URGENT: Final = Probe | ProbeReply
"""The messages that measure a clock, so each wait makes them worse."""

StreamMessage = Samples | Watermark
"""What is told of a stream that is granted."""

Message = (
    Hello
    | SharesRequest
    | Shares
    | Request
    | Release
    | RequestRefusal
    | FormulaRequest
    | FormulaReply
    | FormulaWait
    | Grant
    | StreamMessage
    | Probe
    | ProbeReply
)
"""A message between peers."""


@dataclass(frozen=True, slots=True)
class Packet:
    """Messages of one peer to another one, or to all, in order."""

    incarnation: int
    """The number of the run of the sender, unique among all its runs."""
    messages: tuple[Message, ...]

    @property
    def is_urgent(self) -> bool:
        """True if its messages are urgent."""
        return isinstance(self.messages[0], URGENT)


def _check_numbers(epoch: int, number: int) -> None:
    if epoch < 1 or number < 1:
        raise FederationError(f'epoch {epoch}, number {number}: both count from 1')
