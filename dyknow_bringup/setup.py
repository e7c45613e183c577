from pathlib import Path

from setuptools import find_packages, setup
from setuptools.command.easy_install import ScriptWriter

from dyknow_common.executables import script_template

PACKAGE = 'dyknow_bringup'
NODES = (
    'carrier_simulation',
    'dyknow_nodes',
    'formula_markers',
    'formula_monitor',
    'uav_simulation',
)
DATA = (
    'formulas',
    'launch',
    'layouts',
    'ontology',
    'plans',
    'recordings',
    'robots',
    'scenarios',
    'security',
)


def data_files():
    """Every file of the data folders, installed under share/ in the same folders."""
    found = [path for folder in DATA for path in Path(folder).rglob('*') if path.is_file()]
    return [(f'share/{PACKAGE}/{path.parent.as_posix()}', [path.as_posix()]) for path in found]


ScriptWriter.template = script_template(NODES)

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={PACKAGE: ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
        *data_files(),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='The DyKnow developers',
    maintainer_email='maintainers@dyknow.org',
    description='Launch files, configuration, a UAV fleet simulation and the demonstration of DyKnow.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'carrier_simulation = dyknow_bringup.ros.carrier_simulation:main',
            'dyknow_nodes = dyknow_bringup.ros.composition.dyknow_nodes:main',
            'formula_markers = dyknow_bringup.ros.formula_markers:main',
            'formula_monitor = dyknow_bringup.ros.formula_monitor:main',
            'replay = dyknow_bringup.ros.replay:main',
            'uav_plan = dyknow_bringup.ros.uav_plan:main',
            'uav_demo = dyknow_bringup.ros.uav_demo:main',
            'uav_simulation = dyknow_bringup.ros.uav_simulation:main',
        ],
    },
)
