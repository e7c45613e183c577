"""The version and the dependencies of the wheel, which are written down elsewhere."""

import tomllib
import xml.etree.ElementTree as ET
from pathlib import Path

from hatchling.metadata.plugin.interface import MetadataHookInterface

OPTIONAL = {
    'report': ('images', 'pages'),
    'cluster': ('cluster',),
    'probability': ('probability',),
    'space': ('space',),
}
"""The extras of the wheel, and the dependency groups of each."""


class WheelMetadata(MetadataHookInterface):
    """Take the version of package.xml, and the dependencies of the dependency groups."""

    def update(self, metadata):
        """Add what [project] of pyproject.toml calls dynamic."""
        root = Path(self.root)
        groups = tomllib.loads((root / 'pyproject.toml').read_text('utf-8'))['dependency-groups']
        package = ET.parse(root / 'dyknow_recordings' / 'package.xml')  # noqa: S314 - our own file
        metadata['version'] = package.findtext('version')
        metadata['dependencies'] = groups['run']
        metadata['optional-dependencies'] = {
            extra: [each for name in names for each in groups[name]]
            for extra, names in OPTIONAL.items()
        }
