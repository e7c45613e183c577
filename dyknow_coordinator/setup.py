from setuptools import find_packages, setup
from setuptools.command.easy_install import ScriptWriter

from dyknow_common.executables import script_template

PACKAGE = 'dyknow_coordinator'
NODES = ('stream_reasoning_coordinator',)

ScriptWriter.template = script_template(NODES)

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={'dyknow_coordinator': ['py.typed']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='The DyKnow developers',
    maintainer_email='maintainers@dyknow.org',
    description='Grounds a formula of temporal logic, has it evaluated over the streams of a robot and answers.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'evaluations = dyknow_coordinator.ros.evaluations:main',
            'stream_reasoning_coordinator = dyknow_coordinator.ros.stream_reasoning_coordinator:main',
        ],
    },
)
