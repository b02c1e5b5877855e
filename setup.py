"""All that pyproject.toml cannot say: a wheel holds what is in the tree, nothing of an earlier build, and its
kernels, compiled for the baseline of this family of processors."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

from setuptools import Distribution, setup
from setuptools.command.bdist_wheel import bdist_wheel
from setuptools.command.build import build


class CleanBuild(build):
    """setuptools would pack whatever lies in build/lib, such as modules that are no longer there."""

    def run(self) -> None:
        shutil.rmtree(self.build_lib, ignore_errors=True)
        super().run()
        Path(self.build_lib, "tilth/estimator/kernels").mkdir(parents=True, exist_ok=True)
        # What the checkout has compiled of these very sources is taken from its folder, nothing else of it.
        machine = "deploy/machines/jd7930-parker500.toml"
        command = [sys.executable, "-m", "tilth.logger.compiling", machine, "only"]
        ours = {"PYTHONPATH": self.build_lib, "PYTHONDONTWRITEBYTECODE": "1"}
        subprocess.run(command, check=True, env=os.environ | ours)


class WheelOfAProcessor(bdist_wheel):
    """Any Python 3 takes it; another than the one that built it compiles at its first start."""

    def get_tag(self) -> tuple[str, str, str]:
        return "py3", "none", super().get_tag()[2]


class OfAProcessor(Distribution):
    def has_ext_modules(self) -> bool:
        return True


setup(cmdclass={"build": CleanBuild, "bdist_wheel": WheelOfAProcessor}, distclass=OfAProcessor)
