# SPDX-License-Identifier: Apache-2.0
"""If the compiled part of the module is missing, importing the module must report what is missing
and what to do."""
import os
import pathlib
import subprocess
import sys
import unittest

SOURCE = pathlib.Path(os.environ["RELIDAR_SOURCE_DIR"]) / "tools" / "python"


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
