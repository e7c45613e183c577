"""Run the tests of the packages that need no ROS, under the Python that runs this program.

They run in `.venv-VERSION`, without ROS, and with the pytest and the pytest plugin that are in use
where ROS 2 is installed. With the argument `--environment`, it is only made.
"""

import os
import subprocess
import sys

from set_up import ROOT, dependencies, has_content, install, make_venv, report

VENV = ROOT / '.venv-{}.{}'.format(*sys.version_info[:2])
PYTHON = VENV / 'bin' / 'python'
STAMP = VENV / 'set-up-for'
GROUPS = ('run', 'images', 'pages', 'test', 'test-beside-launch-testing')


def main():
    """Make the environment, unless it is up to date; run the tests, and return their exit code."""
    wanted = sys.version + dependencies()
    if not has_content(STAMP, wanted):
        report(f'making {VENV.name} (half a minute)')
        make_venv(VENV)
        install(VENV, GROUPS)
        STAMP.write_text(wanted, encoding='utf-8')
    if '--environment' in sys.argv[1:]:
        return 0
    packages = sorted(path.parent for path in ROOT.glob('dyknow_*/setup.py'))
    paths = os.pathsep.join(map(str, [*packages, ROOT / 'tests']))
    options = ('-n', 'auto', '-p', 'launch_testing_stub', '-o', f'cache_dir={VENV / "cache"}')
    folders = [str(package / 'test') for package in packages]
    return subprocess.run(
        [str(PYTHON), '-m', 'pytest', *options, *folders],
        cwd=ROOT,
        env={**os.environ, 'PYTHONPATH': paths},
        check=False,
    ).returncode


if __name__ == '__main__':
    sys.exit(main())
