from setuptools import find_packages, setup

PACKAGE = 'dyknow_common'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={
        'dyknow_common': ['py.typed', '**/*.lark', '**/*.xml'],
        'dyknow_main': ['py.typed'],
    },
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='The DyKnow developers',
    maintainer_email='maintainers@dyknow.org',
    description='The parts that every package of DyKnow shares: errors, durations, parsing, units, ROS nodes.',
    license='Apache-2.0',
)
