"""The command without what only POSIX has: modules, signals and functions that Windows lacks."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

PROGRAM = """
import importlib.abc, mmap, os, shutil, signal, subprocess, sys

MODULES = {'fcntl', 'grp', 'posix', 'pty', 'pwd', 'resource', 'syslog', 'termios', 'tty'}
FUNCTIONS = (
    'O_CLOEXEC', 'O_DIRECTORY', 'O_NOFOLLOW', 'O_NONBLOCK', 'fchmod', 'fork', 'getpgid', 'getuid',
    'geteuid', 'killpg', 'mkfifo', 'nice', 'posix_fadvise', 'pread', 'sched_getaffinity', 'setsid',
    'sysconf', 'uname',
)

class Absent(importlib.abc.MetaPathFinder):
    def find_spec(self, name, path=None, target=None):
        if name in MODULES:
            raise ModuleNotFoundError(f"No module named '{name}'", name=name)

# The libraries that know both systems are imported before.
import lz4.frame, numpy, owlready2, pint, rdflib, rich.console, rosbags.rosbag2, tempfile, yaml
for name in MODULES & {*sys.modules}:
    del sys.modules[name]
sys.meta_path.insert(0, Absent())
shutil._use_fd_functions = False  # It has looked for some of these functions already.
for name in FUNCTIONS:
    delattr(os, name)
for name in ('SIGHUP', 'SIGKILL', 'SIGUSR1', 'SIGCHLD', 'SIGALRM', 'setitimer', 'pthread_kill'):
    delattr(signal, name)
signal.Signals = [each for each in signal.Signals if each.name in ('SIGINT', 'SIGTERM', 'SIGABRT')]
for name in ('MADV_DONTNEED', 'MAP_SHARED', 'PROT_READ'):
    delattr(mmap, name)

from dyknow_recordings.check import main

assert not [name for name in sys.modules if name.split('.')[0] == 'rclpy']
sys.exit(main())
"""


@pytest.fixture
def ontology(tmp_path: Path) -> Path:
    path = tmp_path / 'fleet.owl'
    path.write_text(
        '@prefix : <http://example.org/fleet#> . @prefix owl: <http://www.w3.org/2002/07/owl#> .\n'
        '@prefix rdfs: <http://www.w3.org/2000/01/rdf-schema#> .\n'
        '@prefix dyknow: <http://www.dyknow.org/ontology#> .\n'
        '<http://example.org/fleet> a owl:Ontology ; '
        'owl:imports <http://www.dyknow.org/ontology> .\n'
        ':UAV a owl:Class ; rdfs:subClassOf dyknow:Object . :uav1 a :UAV .\n',
        encoding='utf-8',
    )
    return path


def test_a_check_with_an_ontology(ontology: Path, tmp_path: Path) -> None:
    recording = Path(__file__).parents[2] / 'dyknow_bringup' / 'recordings' / 'power_surge'
    done = subprocess.run(
        [
            *(sys.executable, '-c', PROGRAM, str(recording), '--ontology', str(ontology)),
            *('--formula', 'always "/uav2/battery".current > -12'),
            *('--formula', 'forall u in UAV: u = u'),
            *('--verdicts', str(tmp_path / 'verdicts.mcap'), '--json'),
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stderr == ''
    assert done.returncode == 1
    assert '"outcome": "false"' in done.stdout
    assert '"outcome": "true"' in done.stdout
