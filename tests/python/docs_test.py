# SPDX-License-Identifier: Apache-2.0
"""Runs the code of the guide and of the example without changes. PyTorch is not a dependency, so its
blocks are skipped without it."""
import contextlib
import importlib.util
import io
import os
import pathlib
import re
import runpy
import subprocess
import sys
import unittest

import numpy as np

import relidar  # noqa: F401
from common import FOLDER, TestCase

SOURCE = pathlib.Path(os.environ["RELIDAR_SOURCE_DIR"])


@contextlib.contextmanager
def inside(folder):
    folder.mkdir(parents=True)
    before = os.getcwd()
    os.chdir(folder)
    try:
        yield
    finally:
        os.chdir(before)


class Docs(TestCase):
    def test_blocks_of_the_guide(self):
        text = (SOURCE / "docs/python.md").read_text()
        blocks = re.findall(r"^```(python.*?)\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        self.assertEqual([kind for kind, _ in blocks], ["python"] * 3 + ["python torch", "python"] + ["python torch"] * 3)
        names = {}
        with inside(FOLDER / "guide"), contextlib.redirect_stdout(io.StringIO()):
            for kind, block in blocks:
                if kind == "python" or importlib.util.find_spec("torch"):
                    exec(compile(block, "docs/python.md", "exec"), names)

    def test_folder_of_ones_own(self):
        """Three sweeps of 16 beams in a round hall, 1 m apart. `relidar info` must estimate the
        sensor and its path."""
        text = (SOURCE / "docs/datasets.md").read_text()
        blocks = re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)
        self.assertEqual(len(blocks), 1)
        names = {}
        exec(compile(blocks[0], "docs/datasets.md", "exec"), names)
        ring, column = np.divmod(np.arange(16 * 360), 360)
        azimuth, slope = np.pi - np.radians(column + 0.5), np.tan(np.radians(10 - ring))
        points = np.column_stack([20 * np.cos(azimuth), 20 * np.sin(azimuth), 20 * slope, 255 * (ring % 2), ring, -azimuth / (20 * np.pi)])
        poses = np.array([[float(i), 0, 0, 1, 0, 0, 0] for i in range(3)])
        folder = FOLDER / "own_log"
        names["write_log"](folder, [points] * 3, 1e6 + 0.1 * np.arange(3), poses)
        said = subprocess.run([os.environ["RELIDAR_TOOL"], "info", str(folder)], check=True, capture_output=True, text=True).stdout
        self.assertIn("16 rows x 360", said)
        self.assertIn("3 (0 to 2), 0.2 s, 2.0 m", said)
        self.assertIn("100.0 %", said)

    def test_example(self):
        script, folder, printed = SOURCE / "tools/examples/train_and_plot.py", FOLDER / "example", io.StringIO()
        arguments = sys.argv
        sys.argv = [str(script), str(folder), "24"]
        try:
            with contextlib.redirect_stdout(printed):
                runpy.run_path(str(script), run_name="__main__")
        finally:
            sys.argv = arguments
        self.assertIn("iteration 24/24", printed.getvalue())
        for name in ("real.png", "simulated.png", "points.npy", "run/scene.json"):
            self.assertTrue((folder / name).stat().st_size > 0, name)
        self.assertGreater(len(np.load(folder / "points.npy")), 1000)


if __name__ == "__main__":
    unittest.main()
