"""All that pyproject.toml cannot say: a wheel holds what is in the tree, and nothing of an earlier build."""

import shutil

from setuptools import setup
from setuptools.command.build import build


class CleanBuild(build):
    """setuptools would pack whatever lies in build/lib, such as modules that are no longer there."""

    def run(self) -> None:
        shutil.rmtree(self.build_lib, ignore_errors=True)
        super().run()


setup(cmdclass={"build": CleanBuild})
