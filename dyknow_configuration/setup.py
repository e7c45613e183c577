from setuptools import find_packages, setup

PACKAGE = 'dyknow_configuration'

setup(
    name=PACKAGE,
    version='0.1.0',
    packages=find_packages(exclude=['test']),
    package_data={PACKAGE: ['py.typed', '*.yaml']},
    data_files=[
        ('share/ament_index/resource_index/packages', [f'resource/{PACKAGE}']),
        (f'share/{PACKAGE}', ['package.xml']),
    ],
    install_requires=['setuptools'],
    extras_require={'test': ['pytest']},
    zip_safe=False,
    maintainer='The DyKnow developers',
    maintainer_email='maintainers@dyknow.org',
    description='Reads the file that describes a robot: its objects, features, streams, formulas.',
    license='Apache-2.0',
)
