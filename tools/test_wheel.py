"""Build the wheel, install it into an empty environment without ROS, and check a recording there.

The environment and the wheel are temporary; the libraries come from the cache of pip after the
first time. The Python that runs this program is the one that is tested.
"""

import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from set_up import ROOT, report, run

RECORDING = ROOT / 'dyknow_bringup' / 'recordings' / 'power_surge'

IMPORTS = """
import importlib
import importlib.metadata
files = [each for each in importlib.metadata.files('dyknow') if each.suffix == '.py']
names = ['.'.join(each.with_suffix('').parts).removesuffix('.__init__') for each in files]
for name in names:
    importlib.import_module(name)
print(len(names))
"""
"""Imports all modules of the wheel: none may need ROS."""


def main():
    """Return 1 if the wheel does not work."""
    with tempfile.TemporaryDirectory(prefix='dyknow_wheel_') as name:
        folder = Path(name)
        scripts = installed(folder)
        shutil.copytree(RECORDING, folder / 'surge')
        faults = [fault for fault in check(scripts, folder) if fault]
    print('\n'.join(faults) or 'The wheel works without ROS.')
    return 1 if faults else 0


def installed(folder):
    """Return the folder of the executables of an environment with the wheel."""
    report('building the wheel')
    run(sys.executable, '-m', 'venv', str(folder / 'venv'))
    scripts = folder / 'venv' / ('Scripts' if os.name == 'nt' else 'bin')
    pip = (str(scripts / 'python'), '-m', 'pip', '-qq', '--disable-pip-version-check')
    run(*pip, 'wheel', '--no-deps', '--wheel-dir', str(folder), str(ROOT))
    (wheel,) = folder.glob('dyknow-*-py3-none-any.whl')
    report(f'installing {wheel.name} into an empty environment')
    run(*pip, 'install', str(wheel))
    return scripts


def check(scripts, folder):
    """Yield what is wrong with the commands of the wheel, or nothing."""
    yield difference('import of all modules', (scripts / 'python', '-c', IMPORTS), folder, 0)
    dyknow = scripts / 'dyknow'
    formula = 'always "/uav2/battery".current > -12'
    command = (dyknow, 'check', 'surge', '--json', '--formula')
    yield difference('a formula that is true', (*command, '1 < 2'), folder, 0)
    yield difference('a formula that is false', (*command, formula), folder, 1, 13_600_000_000)
    command = (dyknow, 'check', 'surge', '--formula', '1 < 2', '--verdicts', 'verdicts.mcap')
    yield difference('a recording of verdicts', command, folder, 0)
    command = (dyknow, 'check', 'verdicts.mcap', '--topics')
    yield difference('its topics', command, folder, 0, '/dyknow/results')
    (folder / 'trace.csv').write_text('time_s,p\n0,1\n1,2\n', encoding='utf-8')
    command = (dyknow, 'check', 'trace.csv', '--formula', 'always p < 4')
    yield difference('a trace', command, folder, 0)
    yield difference('a command that needs ROS', (dyknow, 'up'), folder, 2, 'needs ROS 2')


def difference(name, command, folder, code, expected=None):
    """Return how the end of a command differs from what is expected, if it does.

    Args:
        name: what is tested.
        command: run in `folder`, without the variables of this process.
        folder: contains the recording.
        code: the exit code.
        expected: a part of the error, or the deciding time after the start of the recording.
    """
    report(name)
    kept = {key: os.environ[key] for key in ('PATH', 'HOME', 'SYSTEMROOT') if key in os.environ}
    done = subprocess.run(
        [*map(str, command)], cwd=folder, env=kept, check=False, capture_output=True, text=True
    )
    output = f'{done.stdout}{done.stderr}'
    if done.returncode != code:
        return f'{name}: exit code {done.returncode} instead of {code}: {output}'
    if isinstance(expected, str):
        return '' if expected in output else f'{name}: {output}'
    if expected is not None:
        found = json.loads(done.stdout)
        (episode,) = found['formulas'][0]['episodes']
        after = episode['decided_at_ns'] - 1_700_000_000_000_000_000
        return '' if after == expected else f'{name}: decided after {after} ns, not {expected}'
    return ''


if __name__ == '__main__':
    sys.exit(main())
