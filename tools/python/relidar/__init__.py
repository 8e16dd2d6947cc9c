# SPDX-License-Identifier: Apache-2.0
"""Re-simulates LiDARs on Vulkan devices: trains scenes on logs, renders scans, and
computes gradients.

Units are metres, seconds and radians. Sensor frame: x forward, y left, z up. Poses are [4,4] float64
matrices a_from_b. Arrays are numpy arrays in C order; rays and surfels are float32. docs/python.md is
the guide.
"""
try:
    from relidar._relidar import *  # noqa: F401,F403
    from relidar._relidar import __version__  # noqa: F401


    def __getattr__(name):
        """Imports relidar.torch, and with it PyTorch, when it is first used. Old names still work in version 0.1."""
        import importlib
        import warnings
        new_names = {"load_sequence": "load_log", "Sequence": "Log"}
        if name in new_names:
            warnings.warn(f"relidar.{name} is now relidar.{new_names[name]}", DeprecationWarning, stacklevel=2)
            return globals()[new_names[name]]
        if name != "torch":
            raise AttributeError(f"module 'relidar' has no attribute '{name}'")
        return importlib.import_module("relidar.torch")
except ModuleNotFoundError as error:
    if error.name != "relidar._relidar":
        raise
    import sys as _sys
    raise ModuleNotFoundError(
        f"relidar: {__path__[0]} has no compiled module for Python {_sys.version_info.major}.{_sys.version_info.minor}; expected "
        "_relidar*.so for this version; install the Debian package of relidar, or build with -DRELIDAR_PYTHON=ON and add "
        "BUILD/tools/python to PYTHONPATH (docs/python.md)",
        name=error.name) from None
