# SPDX-License-Identifier: Apache-2.0
"""`pip install tools/python`: builds the compiled part of the module with CMake in
build/wheel.

With RELIDAR_PYTHON_BUILD=FOLDER it uses an existing CMake build (its tools/python/relidar) and compiles
nothing. The wheel uses libraries of the system (libpng, OpenEXR, SQLite and others), so it only works
on machines with the same distribution.
"""
import os
import pathlib
import re
import shutil
import subprocess
import sys

from setuptools import Extension, setup
from setuptools.command.build_ext import build_ext

ROOT = pathlib.Path(__file__).resolve().parents[2]
BUILD = ROOT / "build" / "wheel"


def version():
    return re.search(r"project\(relidar VERSION ([\d.]+)", (ROOT / "CMakeLists.txt").read_text()).group(1)


class CMakeBuild(build_ext):
    def build_extension(self, extension):
        folder = pathlib.Path(os.environ.get("RELIDAR_PYTHON_BUILD") or self.build_with_cmake())
        # For example "_relidar.cpython-311-x86_64-linux-gnu.so" for this Python.
        suffix = self.get_ext_filename("_relidar")
        built = folder / "tools" / "python" / "relidar" / suffix
        if not built.is_file():
            raise SystemExit(f"relidar: {built} is missing, expected a build with -DRELIDAR_PYTHON=ON for {sys.executable}")
        target = pathlib.Path(self.get_ext_fullpath(extension.name))
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(built, target)

    def build_with_cmake(self):
        if shutil.which("cmake") is None:
            raise SystemExit("relidar: cmake is not installed; run `tools/dev/setup --python` to install all build tools")
        configure = ["cmake", "-S", str(ROOT), "-B", str(BUILD), "-DCMAKE_BUILD_TYPE=Release", "-DRELIDAR_PYTHON=ON", "-DRELIDAR_UNITY=ON",
                     "-DRELIDAR_BUILD_TESTS=OFF", "-DRELIDAR_BUILD_TOOLS=OFF", "-DRELIDAR_SERVE=OFF",
                     f"-DPython_EXECUTABLE={sys.executable}"]
        if shutil.which("ninja"):
            configure += ["-G", "Ninja"]
        subprocess.run(configure, check=True)
        subprocess.run(["cmake", "--build", str(BUILD), "--target", "relidar_python", "--parallel"], check=True)
        return BUILD


BUILD.mkdir(parents=True, exist_ok=True)
setup(version=version(), ext_modules=[Extension("relidar._relidar", sources=[])], cmdclass={"build_ext": CMakeBuild},
      options={"build": {"build_base": str(BUILD / "setuptools")}, "egg_info": {"egg_base": str(BUILD)}})
