"""Make the environment in which DyKnow is built and run, unless it is up to date.

Where ROS 2 Jazzy is sourced, `.venv` sees its packages and adds only the Python libraries that are
missing. Elsewhere `.venv` is a whole ROS 2 Jazzy, installed from PyPI.
"""

import hashlib
import os
import platform
import re
import shutil
import subprocess
import sys
import sysconfig
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
VENV = ROOT / '.venv'
PYTHON = VENV / 'bin' / 'python'
STAMP = VENV / 'set-up-for'
SOURCED = os.environ.get('ROS_DISTRO') == 'jazzy'


def main():
    """Set up `.venv`; return 1 if something is missing on this machine."""
    wanted = fingerprint()
    if STAMP.exists() and STAMP.read_text(encoding='utf-8') == wanted:
        return 0
    missing = missing_prerequisite()
    if missing:
        print(f'DyKnow cannot be set up: {missing}', file=sys.stderr)
        return 1
    for folder in (VENV, ROOT / 'build', ROOT / 'install', ROOT / 'log'):
        shutil.rmtree(folder, ignore_errors=True)
    if SOURCED:
        set_up_beside_ros()
    else:
        set_up_from_pypi()
    STAMP.write_text(wanted, encoding='utf-8')
    return 0


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


def set_up_beside_ros():
    """Add the missing Python libraries to an installed ROS 2."""
    report('ROS 2 Jazzy is sourced: adding the Python libraries that are missing to .venv')
    make_venv('--system-site-packages')
    for group in ('run', 'report', 'check', 'docs'):
        install('--group', group)
    install('--group', 'test', '--group', 'test-beside-launch-testing')


def set_up_from_pypi():
    """Install ROS 2 Jazzy and all libraries into `.venv`."""
    report('no ROS 2 Jazzy is sourced: installing it from PyPI into .venv (270 MB, about a minute)')
    make_venv()
    for group in ('ros', 'build', 'run', 'report', 'test', 'check', 'docs'):
        install('--group', group)
    # The wheels of ROS install lark-parser, the old name of lark, into the same folder.
    run(str(PYTHON), '-m', 'pip', 'uninstall', '-qq', '--yes', 'lark-parser')
    install('--force-reinstall', '--no-deps', 'lark>=1.3,<2')
    correct_paths_of_wheels()


def make_venv(*options):
    """Make an empty `.venv` with a pip that supports dependency groups."""
    # Run from an activated `.venv`, the interpreter has just been removed with it.
    python = getattr(sys, '_base_executable', sys.executable)
    run(python, '-m', 'venv', *options, str(VENV))
    install('pip>=25.1')


def install(*arguments):
    """Install packages with pip."""
    report('pip install ' + ' '.join(arguments))
    run(str(PYTHON), '-m', 'pip', 'install', '-qq', '--disable-pip-version-check', *arguments)


def correct_paths_of_wheels():
    """Replace the paths of the machine that built the wheels of ROS by those of this one."""
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
    """Run a command; if it fails, end this program with its exit code."""
    # The wheels of ROS set this variable for their own Python only.
    environment = {k: v for k, v in os.environ.items() if k != '_ROS_WHEELS_BOOTSTRAP_COMPLETE'}
    code = subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
    if code != 0:
        print(f'failed with exit code {code}: {" ".join(command)}', file=sys.stderr)
        sys.exit(code)


def report(message):
    """Print the progress."""
    print(f'-- {message}', flush=True)


if __name__ == '__main__':
    sys.exit(main())
