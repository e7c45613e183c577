"""All hosts of the fleet on this computer, with a link that fails for 10 s.

    python3 examples/fleet/demo.py

The base station asks about all carriers. While the link to carrier1 is cut, a verdict waits; then
what was missed is asked for again, and the verdict comes.
"""

import os
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from contextlib import ExitStack, suppress
from pathlib import Path

from host import FIRST_DOMAIN, FOLDER, HOSTS

PORT, LINK_PORT = 7447, 7448
OUTAGE_S = 10.0
START_LIMIT_S = 90.0
FORMULA = 'forall c in Carrier: always[0 s, 5 s] Charge[c] > 0.2'


class Link:
    """The link of a carrier: a process between its two ends, which can let nothing pass."""

    def __init__(self):
        self._is_cut = False
        self._ends = []
        self._server = socket.create_server(('127.0.0.1', LINK_PORT))
        threading.Thread(target=self._accept, daemon=True).start()

    def cut(self):
        """Let nothing pass, and refuse connections."""
        self._is_cut = True
        for each in self._ends:
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)

    def restore(self):
        """Let connections pass again."""
        self._is_cut = False

    def _accept(self):
        while True:
            near, _ = self._server.accept()
            with suppress(OSError):
                if self._is_cut:
                    near.close()
                    continue
                far = socket.create_connection(('127.0.0.1', PORT))
                self._ends += [near, far]
                for ends in ((near, far), (far, near)):
                    threading.Thread(target=self._pass_on, args=ends, daemon=True).start()

    @staticmethod
    def _pass_on(source, goal):
        with suppress(OSError):
            while data := source.recv(65536):
                goal.sendall(data)
        for each in (source, goal):
            with suppress(OSError):
                each.shutdown(socket.SHUT_RDWR)


def base_environment():
    """Return the variables of commands at the base station."""
    return {**os.environ, 'ROS_DOMAIN_ID': str(FIRST_DOMAIN)}


def ask(formula, timeout='60 s'):
    """Return a process that asks the base station."""
    line = ['dyknow', 'evaluate', formula, '--timeout', timeout]
    return subprocess.Popen(line, env=base_environment(), stdout=subprocess.PIPE, text=True)


def wait_for_carriers():
    """Wait until the base station knows all carriers; return False if it does not in time."""
    end = time.monotonic() + START_LIMIT_S
    line = ['dyknow', 'federation', '--json']
    while time.monotonic() < end:
        done = subprocess.run(
            line, env=base_environment(), capture_output=True, text=True, check=False
        )
        if done.stdout.count('"Charge_') >= len(HOSTS) - 1:
            return True
    return False


def start_hosts(hosts, folder):
    """Start all hosts; the robot.yaml of carrier1 leads to the link."""
    detour = folder / 'carrier1.yaml'
    text = (FOLDER / 'carrier1.yaml').read_text().replace(str(PORT), str(LINK_PORT))
    detour.write_text(text)
    (folder / 'loopback.json5').write_text((FOLDER / 'loopback.json5').read_text())
    for name in HOSTS:
        line = [sys.executable, str(FOLDER / 'host.py'), name]
        line += ['--robot', str(detour)] if name == 'carrier1' else []
        hosts.append(subprocess.Popen(line, stdout=subprocess.DEVNULL))


def stop(hosts):
    """End all hosts."""
    for each in hosts:
        each.send_signal(signal.SIGINT)
    for each in hosts:
        each.wait()


def main():
    """Run the demonstration; the exit code is 0 if the verdict is true."""
    link = Link()
    hosts = []
    with tempfile.TemporaryDirectory() as folder, ExitStack() as stack:
        stack.callback(stop, hosts)
        start_hosts(hosts, Path(folder))
        print('starting four hosts ...', flush=True)
        if not wait_for_carriers():
            print('the carriers did not come up', file=sys.stderr)
            return 2
        subprocess.run(['dyknow', 'federation'], env=base_environment(), check=False)
        start = time.monotonic()

        def tell(text):
            print(f'{time.monotonic() - start:5.1f} s  {text}', flush=True)

        tell(f'asked: {FORMULA}')
        asked = ask(FORMULA)
        time.sleep(2)
        link.cut()
        tell('the link to carrier1 is cut')
        time.sleep(OUTAGE_S)
        tell('the verdict waits' if asked.poll() is None else 'there is a verdict already')
        link.restore()
        tell('the link is back')
        answer, _ = asked.communicate()
        tell(answer.strip())
        return asked.returncode


if __name__ == '__main__':
    sys.exit(main())
