#!/bin/sh
# Removes the data of robots that AVR Gym does not have: 200 of the 326 MB of the package rtb-data.
# Of the Python that PYTHON names, or the first on the path; `pip install --force-reinstall --no-deps rtb-data==1.1.0` brings it back.
set -eu
cd "$("${PYTHON:-python}" -c 'import rtbdata; print(next(iter(rtbdata.__path__)))')"
find . -mindepth 1 -maxdepth 1 ! -name __init__.py ! -name xacro -exec rm -r {} +
find xacro -mindepth 1 -maxdepth 1 ! -name kinova_description ! -name pr2_description \
    ! -name franka_description ! -name kortex_description ! -name ur_description -exec rm -r {} +
du -sh .
