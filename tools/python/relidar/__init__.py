# SPDX-License-Identifier: Apache-2.0
"""Re-simulate any LiDAR on any Vulkan device: logs become scenes, scenes become scans, scans have gradients.

Metres, seconds, radians. Sensor frame: x forward, y left, z up. Poses are [4,4] float64 matrices a_from_b. Arrays are numpy's;
float32 where rays and surfels are meant, in C order. docs/python.md is the guide.
"""
from relidar._relidar import *  # noqa: F401,F403
from relidar._relidar import __version__  # noqa: F401
