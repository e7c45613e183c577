from setuptools import find_packages, setup
from setuptools.command.easy_install import ScriptWriter

from dyknow_common.executables import script_template

PACKAGE = 'dyknow_stream_processing'
NODES = ('stream_manager', 'stream_processing_engine')

ScriptWriter.template = script_template(NODES)

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={'dyknow_stream_processing': ['py.typed', '**/*.lark']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='The DyKnow developers',
    maintainer_email='maintainers@dyknow.org',
    description='The stream language of DyKnow, its operators, StreamProxy, the stream manager and the stream processing engine.',
    license='Apache-2.0',
    entry_points={
        'console_scripts': [
            'generate_conversions = dyknow_stream_processing.ros.messages.generate_conversions:main',
            'stream_manager = dyknow_stream_processing.ros.stream_manager:main',
            'stream_processing_engine = dyknow_stream_processing.ros.stream_processing_engine:main',
            'streams = dyknow_stream_processing.ros.streams:main',
        ],
    },
)
