"""Signals in an executable: while it works, and when its work is done."""

from __future__ import annotations

import signal
import subprocess
import sys

import pytest

LATE_SIGNAL = """
import ctypes, signal
from dyknow_main import handle, ignore

signal.signal(signal.{name}, signal.SIG_DFL)  # nohup ignores SIGHUP.
handle([signal.{name}], lambda *_: None)
libc = ctypes.CDLL(None)
libc.signal.restype = ctypes.c_void_p
handler = ctypes.CFUNCTYPE(None, ctypes.c_int)(libc.signal(signal.{name}, None))
ignore([signal.{name}])
handler(signal.{name})  # A thread got the signal before, and only runs its handler now.
print('clean')
"""

SIGNALS_AT_THE_END = """
import atexit, os, signal
from dyknow_main import handle, ignore

atexit.register(os.kill, os.getpid(), signal.{name})
handle([signal.{name}], lambda *_: None)
ignore([signal.{name}])
os.kill(os.getpid(), signal.{name})
print('clean')
"""

WHILE_LOADING = """
import os, signal
from importlib import metadata
from dyknow_main import load

signal.signal(signal.{name}, signal.SIG_DFL)  # nohup ignores SIGHUP.
metadata.distribution = lambda _: os.kill(os.getpid(), signal.{name})
load('dyknow', 'dyknow', is_node=False)
"""

HALF_MADE = """
import os
import signal

from dyknow_common.executables import interruptible

class Half:
    def __init__(self):
        os.kill(os.getpid(), signal.SIGTERM)
        self.name = 'whole'

    def __del__(self):
        print(self.name)

try:
    with interruptible():
        Half()
except KeyboardInterrupt as error:
    print(*error.args)
"""


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM', 'SIGHUP'])
@pytest.mark.parametrize('program', [LATE_SIGNAL, SIGNALS_AT_THE_END])
def test_ignored_signals_say_nothing(program: str, name: str) -> None:
    command = [sys.executable, '-c', program.format(name=name)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False, timeout=60)
    assert (ended.returncode, ended.stdout, ended.stderr) == (0, 'clean\n', '')


def test_an_object_that_a_signal_leaves_half_made_prints_nothing() -> None:
    done = subprocess.run(
        [sys.executable, '-c', HALF_MADE], capture_output=True, text=True, check=False
    )
    assert (done.stdout, done.stderr, done.returncode) == ('15\n', '', 0)


@pytest.mark.parametrize('name', ['SIGINT', 'SIGTERM', 'SIGHUP'])
def test_a_signal_while_a_command_is_loaded(name: str) -> None:
    command = [sys.executable, '-c', WHILE_LOADING.format(name=name)]
    ended = subprocess.run(command, capture_output=True, check=False, timeout=60)
    assert ended.returncode == 128 + signal.Signals[name]
