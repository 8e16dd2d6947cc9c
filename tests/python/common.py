# SPDX-License-Identifier: Apache-2.0
"""A small street and a run trained on it, made once for all tests of a process, and the way relidar itself fails."""
import functools
import os
import pathlib
import subprocess
import sys
import tempfile
import unittest

import numpy as np

import relidar

try:
    relidar.devices()
except relidar.DeviceError as error:
    if os.environ.get("RELIDAR_REQUIRE_GPU") != "1":
        print(f"skipped: {error}")
        sys.exit(77)   # ctest's word for skipped
    raise

SETTINGS = {"train.iterations": 60, "train.log_every": 10, "init.voxel_m": 0.3, "dataset.test_every": 4}
WORK = tempfile.TemporaryDirectory(prefix="relidar-python-")
FOLDER = pathlib.Path(WORK.name)


@functools.cache
def street():
    """Folder of a log of 8 frames with 16 x 256 rays and two moving cars."""
    folder = FOLDER / "street"
    relidar.save_street(folder, n_frames=8, rows=16, columns=256)
    return folder


@functools.cache
def config():
    return relidar.Config("quick", SETTINGS)


@functools.cache
def log():
    return relidar.load_sequence(street(), config())


@functools.cache
def run():
    """Trained, saved, and read back."""
    folder = FOLDER / "run"
    relidar.train(log(), config()).save(folder)
    return relidar.Run.load(folder)


def tool(*arguments):
    """Runs the command line tool, another way to the same library."""
    subprocess.run([os.environ["RELIDAR_TOOL"], *map(str, arguments), "--quiet"], check=True)


class TestCase(unittest.TestCase):
    def assert_fails(self, error, text, call, *arguments, **named):
        """The call raises exactly this error, with one line that holds the text."""
        with self.assertRaises(error) as caught:
            call(*arguments, **named)
        self.assertIs(type(caught.exception), error)
        message = str(caught.exception)
        self.assertNotIn("\n", message)
        self.assertIn(text, message)

    def assert_same(self, actual, expected):
        """Equal arrays of equal dtype and shape."""
        self.assertEqual((actual.dtype, actual.shape), (expected.dtype, expected.shape))
        np.testing.assert_array_equal(actual, expected)
