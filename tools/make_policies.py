"""Write the SROS2 policies of the launch files; run it when the interfaces of a node change."""

import sys
from pathlib import Path

from dyknow_bringup.security.systems import shipped_policies

FOLDER = Path(__file__).parent.parent / 'dyknow_bringup' / 'security'


def main():
    """Write one file for each launch file."""
    FOLDER.mkdir(exist_ok=True)
    for name, text in shipped_policies().items():
        (FOLDER / f'{name}.policy.xml').write_text(text, encoding='utf-8')


if __name__ == '__main__':
    sys.exit(main())
