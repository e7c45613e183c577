"""Makes the environment that DyKnow is built and run in; does nothing when it stands already.

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
    """Sets up `.venv`; the exit code is 1 when something is missing on this machine."""
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
    """What the environment depends on, as one text."""
    dependencies = (ROOT / 'pyproject.toml').read_text(encoding='utf-8').split('[tool.', 1)[0]
    parts = (dependencies, Path(__file__).read_text(encoding='utf-8'), sys.version, str(ROOT))
    world = 'ros' if SOURCED else 'pypi'
    return f'{world} {hashlib.sha256("".join(parts).encode()).hexdigest()}\n'


def missing_prerequisite():
    """What this machine lacks, with the mend; None when it lacks nothing."""
    if sys.version_info < (3, 11):
        found = '.'.join(str(number) for number in sys.version_info[:2])
        return f'Python 3.11 or newer is needed, this is {found}; say: make PYTHON=python3.12 ...'
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
    """Adds to an installed ROS 2 the Python libraries that it lacks."""
    say('ROS 2 Jazzy is sourced: adding the Python libraries that are missing to .venv')
    make_venv('--system-site-packages')
    for group in ('run', 'check'):
        install('--group', group)


def set_up_from_pypi():
    """Installs ROS 2 Jazzy and all else into `.venv`."""
    say('no ROS 2 Jazzy is sourced: installing it from PyPI into .venv (270 MB, about a minute)')
    make_venv()
    for group in ('ros', 'build', 'run', 'check'):
        install('--group', group)
    # ROS's wheels bring lark-parser, the old name of lark, into the same folder.
    install('--force-reinstall', '--no-deps', 'lark>=1.3,<2')
    mend_paths_of_wheels()


def make_venv(*options):
    """Makes an empty `.venv` with a pip that knows dependency groups."""
    run(sys.executable, '-m', 'venv', *options, str(VENV))
    install('pip>=25.1')


def install(*arguments):
    """Installs with pip, quietly but for its progress."""
    say('pip install ' + ' '.join(arguments))
    run(str(PYTHON), '-m', 'pip', 'install', '-qq', '--disable-pip-version-check', *arguments)


def mend_paths_of_wheels():
    """Replaces the paths of the machine that built ROS's wheels by those of this one."""
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
    """Runs a command; ends this program with its exit code when it fails."""
    # The wheels of ROS mark the environment of their own Python; another must not inherit it.
    environment = {k: v for k, v in os.environ.items() if k != '_ROS_WHEELS_BOOTSTRAP_COMPLETE'}
    code = subprocess.run(command, cwd=ROOT, env=environment, check=False).returncode
    if code != 0:
        print(f'failed with exit code {code}: {" ".join(command)}', file=sys.stderr)
        sys.exit(code)


def say(message):
    """Shows progress."""
    print(f'-- {message}', flush=True)


if __name__ == '__main__':
    sys.exit(main())
