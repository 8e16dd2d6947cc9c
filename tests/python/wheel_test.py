# SPDX-License-Identifier: Apache-2.0
"""Builds the wheel of tools/python from this build and installs it into an empty folder, as `pip
install tools/python` does. Without the compiled part, an import must report what is missing and what
to do."""
import importlib.util
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

import relidar

SOURCE = pathlib.Path(os.environ["RELIDAR_SOURCE_DIR"]) / "tools" / "python"
BUILD = pathlib.Path(relidar.__file__).resolve().parents[3]
PIP = [sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", "--quiet"]
PROGRAM = """
import importlib.metadata, pathlib, relidar
print(pathlib.Path(relidar.__file__).parent)
print(importlib.metadata.version("relidar"), relidar.__version__)
relidar.save_street("street", n_frames=2, rows=4, columns=16)
print(len(relidar.load_log("street", relidar.Config("quick")).times))
"""


@unittest.skipUnless(all(importlib.util.find_spec(name) for name in ("pip", "setuptools", "wheel")), "no pip, setuptools or wheel")
class Wheel(unittest.TestCase):
    def setUp(self):
        self.folder = tempfile.TemporaryDirectory(prefix="relidar-wheel-")
        self.addCleanup(self.folder.cleanup)
        self.path = pathlib.Path(self.folder.name)

    def build(self, build):
        environment = dict(os.environ, RELIDAR_PYTHON_BUILD=str(build))
        return subprocess.run([*PIP, "wheel", "--no-build-isolation", "--no-deps", "--no-index", "-w", str(self.path), str(SOURCE)],
                              env=environment, capture_output=True, text=True)

    def test_runs_where_it_is_installed(self):
        made = self.build(BUILD)
        self.assertEqual(made.returncode, 0, made.stderr)
        # the wheel is specific to this system, because it has a compiled part
        wheels = list(self.path.glob("relidar-*-linux_*.whl"))
        self.assertEqual(len(wheels), 1, list(self.path.iterdir()))
        site = self.path / "site"
        subprocess.run([*PIP, "install", "--no-index", "--no-deps", "--target", str(site), str(wheels[0])], check=True)
        self.assertEqual(sorted(p.name.split(".")[0] for p in (site / "relidar").iterdir() if p.is_file()),
                         ["__init__", "__init__", "_losses", "_relidar", "py", "scan_dataset", "torch"])
        out = subprocess.run([sys.executable, "-B", "-c", PROGRAM], env=dict(os.environ, PYTHONPATH=str(site)), cwd=self.path, check=True,
                             capture_output=True, text=True).stdout.split()
        self.assertEqual(out, [str(site / "relidar"), relidar.__version__, relidar.__version__, "2"])

    def test_says_that_a_build_has_no_module(self):
        made = self.build(self.path)
        self.assertNotEqual(made.returncode, 0)
        self.assertIn("-DRELIDAR_PYTHON=ON", made.stdout + made.stderr)


class Import(unittest.TestCase):
    def test_the_source_folder_says_that_it_is_not_built(self):
        process = subprocess.run([sys.executable, "-B", "-c", "import relidar"], env=dict(os.environ, PYTHONPATH=str(SOURCE)),
                                 capture_output=True, text=True)
        self.assertEqual(process.returncode, 1)
        message = process.stderr.strip().splitlines()[-1]
        self.assertRegex(message, r"^ModuleNotFoundError: relidar: .*tools/python/relidar .*Python 3\.\d+")
        self.assertIn("RELIDAR_PYTHON=ON", message)


if __name__ == "__main__":
    unittest.main()
