# SPDX-License-Identifier: Apache-2.0
"""Makes a small street and a trained run once for all tests of a process. Provides checks of the
errors that relidar raises."""
import functools
import os
import pathlib
import re
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
        sys.exit(77)   # exit code with which ctest marks a test as skipped
    raise

SETTINGS = {"train.iterations": 30, "train.log_every": 5, "init.voxel_m": 0.3, "dataset.test_every": 4}
WORK = tempfile.TemporaryDirectory(prefix="relidar-python-")
FOLDER = pathlib.Path(WORK.name)


@functools.cache
def street():
    """Returns the folder of a log of 8 frames with 16 x 256 rays and two moving cars."""
    folder = FOLDER / "street"
    relidar.save_street(folder, n_frames=8, rows=16, columns=256)
    return folder


@functools.cache
def config():
    return relidar.Config("quick", SETTINGS)


@functools.cache
def log():
    return relidar.load_log(street(), config())


@functools.cache
def run():
    """Returns a run that was trained, saved, and read back."""
    folder = FOLDER / "run"
    relidar.train(log(), config()).save(folder)
    return relidar.Run.load(folder)


def tool(*arguments):
    """Runs the command line tool, which uses the same library."""
    subprocess.run([os.environ["RELIDAR_TOOL"], *map(str, arguments), "--quiet"], check=True)


class TestCase(unittest.TestCase):
    def assert_fails(self, error, text, call, *arguments, **named):
        """Checks that the call raises exactly this error, with a message of a single line that
        contains, in this order, the parts of the text that " ... " separates."""
        with self.assertRaises(error) as caught:
            call(*arguments, **named)
        self.assertIs(type(caught.exception), error)
        message = str(caught.exception)
        self.assertNotIn("\n", message)
        self.assertRegex(message, ".*".join(map(re.escape, text.split(" ... "))) or ".")

    def assert_same(self, actual, expected):
        """Checks that two arrays have equal values, dtype and shape."""
        self.assertEqual((actual.dtype, actual.shape), (expected.dtype, expected.shape))
        np.testing.assert_array_equal(actual, expected)
