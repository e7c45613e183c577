"""Two hosts whose packets the kernel delays, loses and doubles: netem, in a network namespace.

The hosts reach each other over a router of zenoh, which runs in the namespace, over one pair of
virtual interfaces. The test needs the right to make them, `ip`, `tc`, and a kernel with netem.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from dyknow_interfaces.msg import FormulaResult

from dyknow_common import NANOSECONDS
from federations import BASE, CARRIER, ZENOH, Host, wait_for, wait_for_streams

NAMESPACE = 'dyknow_netem'
NEAR, FAR = '198.51.100.1', '198.51.100.2'
"""Addresses for documentation, which no network has."""
END = f'tcp/{FAR}:7447'
DELAY_MS = 40
NETEM = f'netem delay {DELAY_MS}ms 5ms loss 5% duplicate 2%'

PREPARATIONS = (
    f'ip netns add {NAMESPACE}',
    f'ip link add dyknow_near type veth peer name dyknow_far netns {NAMESPACE}',
    f'ip address add {NEAR}/30 dev dyknow_near',
    f'ip -n {NAMESPACE} address add {FAR}/30 dev dyknow_far',
    'ip link set dyknow_near up',
    f'ip -n {NAMESPACE} link set dyknow_far up',
    f'tc qdisc add dev dyknow_near root {NETEM}',
    f'tc -n {NAMESPACE} qdisc add dev dyknow_far root {NETEM}',
)

ROUTER = """
import sys, zenoh
with zenoh.open(zenoh.Config.from_json5(sys.argv[1])):
    print('open', flush=True)
    sys.stdin.read()
"""


@pytest.fixture
def router() -> Iterator[None]:
    """A router behind a link that is delayed and lossy in both directions."""
    try:
        for each in PREPARATIONS:
            try:
                subprocess.run(each.split(), check=True, capture_output=True, text=True)
            except (OSError, subprocess.CalledProcessError) as error:
                reason = getattr(error, 'stderr', '') or error
                pytest.skip(f'no link with netem can be made here: {each}: {reason}')
        settings = ZENOH.replace('{', f'{{mode: "router", listen: {{endpoints: ["{END}"]}},', 1)
        python = [sys.executable, '-c', ROUTER, settings]
        command, pipe = ['ip', 'netns', 'exec', NAMESPACE, *python], subprocess.PIPE
        with subprocess.Popen(command, stdin=pipe, stdout=pipe, text=True) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == 'open\n'
            yield
            process.communicate()
    finally:  # Its interfaces end with it.
        subprocess.run(['ip', 'netns', 'delete', NAMESPACE], check=False, capture_output=True)


@pytest.mark.usefixtures('router')
def test_a_formula_is_about_another_host_over_a_bad_link(tmp_path: Path) -> None:
    zenoh = ZENOH.replace('{', '{mode: "client",', 1)
    ends = f'connect: {END}'
    base = Host(tmp_path / 'base', BASE.format(ends=ends), zenoh)
    carrier = Host(tmp_path / 'carrier1', CARRIER.format(name='carrier1', ends=ends), zenoh)
    carrier.publish_battery('carrier1')
    with ExitStack() as stack:
        for each in (base, carrier):
            stack.enter_context(each)
        wait_for_streams(2, base, carrier)
        asked = base.ask('forall c in Carrier: always[0 s, 3 s] Charge[c] > 0.5')
        wait_for(base, carrier, until=asked.done, what='the answer')
        assert asked.result().verdict == FormulaResult.TRUE, asked.result()
        (peer,) = base.reports[-1].peers
        # Both ways lead over the link twice. Both hosts have one clock: the truth is 0.
        assert peer.delay is not None
        assert peer.delay >= 4 * (DELAY_MS - 5) * NANOSECONDS['ms']
        assert peer.offset is not None
        assert peer.uncertainty is not None
        assert abs(peer.offset) <= peer.uncertainty
