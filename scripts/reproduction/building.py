"""Builds what a measuring script runs. Imports nothing that is not Python's own: it installs the rest."""
import os
import subprocess
import sys

REPOSITORY = os.path.dirname(os.path.dirname(os.path.dirname(os.path.abspath(__file__))))


def build(script, packages, benchmarks):
    """Installs Debian packages that only this script needs, and builds the programs and its benchmarks into build/."""
    for command in (["scripts/install_dependencies", *packages],
                    ["scripts/build", "bezier_fem_programs"],
                    ["cmake", "-DBEZIER_FEM_BENCH=ON", "build"],
                    ["cmake", "--build", "build", "--target", *benchmarks]):
        done = subprocess.run(command, cwd=REPOSITORY, check=False,
                              stdout=subprocess.DEVNULL if command[0] == "cmake" else None)
        if done.returncode != 0:
            sys.exit(f"{script}: {' '.join(command)} failed, see above")
