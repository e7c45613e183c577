"""Make the environment in which DyKnow is built and run, unless it is up to date.

Where ROS 2 Jazzy is sourced, `.venv` sees its packages and adds only the Python libraries that are
missing. Elsewhere `.venv` is a whole ROS 2 Jazzy, installed from PyPI.

With the argument `--tests`, the environment also gets what the tests and the checks need.
"""

import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / '.venv'
PYTHON = VENV / 'bin' / 'python'
STAMP = VENV / 'set-up-for'
TEST_STAMP = VENV / 'set-up-for-tests'
SOURCED = os.environ.get('ROS_DISTRO') == 'jazzy'

GROUPS = (*([] if SOURCED else ['ros', 'build']), 'run', 'pages', 'dashboard', 'completion')
"""The dependency groups that the demonstration and the commands need."""

TEST_GROUPS = ('images', 'test', 'check', 'docs', *(['test-beside-launch-testing'] * SOURCED))
"""The dependency groups that the tests and the checks need besides."""


def main():
    """Set up `.venv`; return 1 if something is missing on this machine."""
    wanted = fingerprint()
    if not has_content(STAMP, wanted):
        missing = missing_prerequisite()
        if missing:
            print(f'DyKnow cannot be set up: {missing}', file=sys.stderr)
            return 1
        for folder in (VENV, ROOT / 'build', ROOT / 'install', ROOT / 'log'):
            shutil.rmtree(folder, ignore_errors=True)
        make_environment()
        STAMP.write_text(wanted, encoding='utf-8')
    if '--tests' in sys.argv[1:] and not has_content(TEST_STAMP, wanted):
        report('adding to .venv what the tests and the checks need (half a minute)')
        install(VENV, TEST_GROUPS)
        TEST_STAMP.write_text(wanted, encoding='utf-8')
    return 0


def has_content(path, text):
    """Return True if there is a file with just this text."""
    return path.exists() and path.read_text(encoding='utf-8') == text


def fingerprint():
    """Return a text that changes when the environment must be made again."""
    parts = (dependencies(), Path(__file__).read_text(encoding='utf-8'), sys.version, str(ROOT))
    origin = 'ros' if SOURCED else 'pypi'
    return f'{origin} {hashlib.sha256("".join(parts).encode()).hexdigest()}\n'


def dependencies():
    """Return the dependency groups of pyproject.toml, as a text."""
    text = (ROOT / 'pyproject.toml').read_text(encoding='utf-8')
    return text.partition('[dependency-groups]')[2].partition('[tool.')[0]


def missing_prerequisite():
    """Return what this machine lacks and how to install it; None if it lacks nothing."""
    if sys.version_info < (3, 11):
        found = '.'.join(str(number) for number in sys.version_info[:2])
        return f'Python 3.11 or newer is needed, this is {found}; run: make PYTHON=python3.12 ...'
    if not SOURCED and (sys.platform != 'linux' or platform.machine() != 'x86_64'):
        return (
            f'ROS 2 comes from PyPI for Linux on x86_64 only, this is {sys.platform} on '
            f'{platform.machine()}; install ROS 2 Jazzy and source its setup.bash'
        )
    if not (Path(sysconfig.get_paths()['include']) / 'Python.h').exists():
        return 'the headers of Python are missing; on Debian and Ubuntu: apt install python3-dev'
    if not any(shutil.which(name) for name in (os.environ.get('CXX', 'c++'), 'c++', 'g++')):
        return 'a C++ compiler is missing; on Debian and Ubuntu: apt install g++'
    if SOURCED and not shutil.which('colcon'):
        return 'colcon is missing; on Ubuntu: apt install python3-colcon-common-extensions'
    return None


def make_environment():
    """Make `.venv` with what the demonstration and the commands need."""
    if SOURCED:
        report('ROS 2 Jazzy is sourced: adding the Python libraries that are missing to .venv')
        make_venv(VENV, '--system-site-packages')
    else:
        report('no ROS 2 Jazzy is sourced: installing it from PyPI into .venv (half a minute)')
        make_venv(VENV)
    install(VENV, GROUPS)
    if not SOURCED:
        # The wheels of ROS install lark-parser, the old name of lark, into the same folder.
        run(str(PYTHON), '-m', 'pip', 'uninstall', '-qq', '--yes', 'lark-parser')
        pip(VENV, '--force-reinstall', '--no-deps', 'lark>=1.3,<2')
        correct_paths_of_wheels()


def make_venv(venv, *options):
    """Make an empty environment with a pip that supports dependency groups."""
    # Run from an activated `.venv`, the interpreter has just been removed with it.
    python = getattr(sys, '_base_executable', sys.executable)
    run(python, '-m', 'venv', '--clear', *options, str(venv))
    pip(venv, 'pip>=25.1')


def install(venv, groups):
    """Install dependency groups with pip, in one call: it reads the index of a package once."""
    pip(venv, *(argument for group in groups for argument in ('--group', group)))


def pip(venv, *arguments):
    """Install packages with pip, which compiles none: Python compiles what is imported."""
    options = ('--disable-pip-version-check', '--no-compile')
    run(str(venv / 'bin' / 'python'), '-m', 'pip', 'install', *options, *arguments)


def correct_paths_of_wheels():
    """Replace paths of the machine that built the wheels of ROS by paths of this one."""
    include = sysconfig.get_config_var('INCLUDEPY')
    version = f'python{sys.version_info[0]}.{sys.version_info[1]}'
    site_packages = str(VENV / 'lib' / version / 'site-packages')
    for path in (VENV / 'share').rglob('*.cmake'):
        old = path.read_text(encoding='utf-8')
        new = re.sub(r'/opt/python/cp[^/]+/include/python3\.\d+', include, old)
        new = re.sub(r'/opt/python/cp[^/]+/lib/python3\.\d+/site-packages', site_packages, new)
        if new != old:
            path.write_text(new, encoding='utf-8')


def run(*command):
    """Run a command; if it fails, print its output and end this program with its exit code.

    On a terminal, a line shows the last line of its output and the seconds since its start.
    """
    # The wheels of ROS set this variable for their own Python only.
    environment = {k: v for k, v in os.environ.items() if k != '_ROS_WHEELS_BOOTSTRAP_COMPLETE'}
    start = time.monotonic()
    with tempfile.TemporaryFile() as output:
        with subprocess.Popen(
            command, cwd=ROOT, env=environment, stdout=output, stderr=subprocess.STDOUT
        ) as process:
            while process.poll() is None:
                show(f'[{time.monotonic() - start:.0f} s] {last_line(output)}')
                time.sleep(0.1)
        show('')
        if process.returncode != 0:
            output.seek(0)
            print(output.read().decode(errors='replace'), file=sys.stderr)
            print(
                f'failed with exit code {process.returncode}: {" ".join(command)}', file=sys.stderr
            )
            sys.exit(process.returncode)


def last_line(output):
    """Return the last line that was written to a file."""
    # The process writes at the position of this file, which it shares: reading must not move it.
    size = os.fstat(output.fileno()).st_size
    end = os.pread(output.fileno(), 4000, max(0, size - 4000)).decode(errors='replace')
    return (end.strip().splitlines() or [''])[-1].strip()


def show(line):
    """Replace the last line of the terminal, if there is one."""
    if sys.stdout.isatty():
        width = shutil.get_terminal_size().columns - 1
        print(f'\r\033[K{line[:width]}', end='', flush=True)


def report(message):
    """Print the progress."""
    print(f'-- {message}', flush=True)


if __name__ == '__main__':
    sys.exit(main())
