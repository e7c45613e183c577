from setuptools import find_packages, setup
from setuptools.command.easy_install import ScriptWriter

from dyknow_common.executables import script_template

PACKAGE = 'dyknow_reasoning'
NODES = ('stream_reasoning_engine',)

ScriptWriter.template = script_template(NODES)

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={'dyknow_reasoning': ['py.typed', '**/*.lark']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='The DyKnow developers',
    maintainer_email='maintainers@dyknow.org',
    description='Metric temporal logic over streams, evaluated by progression, and the stream reasoning engine.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'check = dyknow_reasoning.check:main',
            'stream_reasoning_engine = dyknow_reasoning.ros.stream_reasoning_engine:main',
        ],
    },
)
