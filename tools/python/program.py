#!python
# SPDX-License-Identifier: Apache-2.0
"""The command `relidar` of the wheel: starts the program inside the module, without loading the module."""
import importlib.util
import os
import sys

module = importlib.util.find_spec("relidar")
program = os.path.join(os.path.dirname(module.origin), "bin", "relidar")
os.execv(program, ["relidar", *sys.argv[1:]])
