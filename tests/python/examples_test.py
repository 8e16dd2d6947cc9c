# SPDX-License-Identifier: Apache-2.0
"""Runs the examples with PyTorch in a short form on the street: scores, an error of a pose, a recall."""
import contextlib
import functools
import importlib.machinery
import importlib.util
import io
import os
import pathlib
import unittest

import numpy as np

import relidar
from common import FOLDER, TestCase, config, log

if importlib.util.find_spec("torch"):
    import torch
else:
    print("skipped: examples_test.py, because PyTorch is not installed")


def load(name, path=None):
    """Imports an example, or another program of tools, without running its main()."""
    path = pathlib.Path(os.environ["RELIDAR_SOURCE_DIR"]) / (path or f"tools/examples/{name}.py")
    loader = importlib.machinery.SourceFileLoader(name, str(path))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader(name, loader))
    loader.exec_module(module)
    return module


def settings(iterations):
    changed = config().copy()
    changed["train.iterations"], changed["refine.enabled"] = iterations, False
    return changed


@functools.cache
def trained():
    return relidar.train(log(), settings(100))


@unittest.skipUnless(importlib.util.find_spec("torch"), "PyTorch is not installed")
class Examples(TestCase):
    def setUp(self):
        torch.manual_seed(1)

    def test_train(self):
        """The scores of held-out scans are near those of relidar.train() after as many iterations."""
        start = relidar.train(log(), settings(1))
        found = load("torch_train").train(start, log(), 100)
        scores = [relidar.evaluate(scene, log())["mean"] for scene in (start, trained(), found)]
        for name, share in (("depth_mae_m", 0.5), ("cd_mean_m", 0.7), ("intensity_rmse", 0.6)):
            first, native, last = (score["strict/" + name] for score in scores)
            self.assertLess(last, share * first, name)
            self.assertLess(last, 1.1 * native, name)

    def test_mounting(self):
        module = load("torch_mounting")
        np.testing.assert_allclose(module.pose_error(relidar.pose(0, 0, 0.3, 0, 3), np.eye(4)), (0.3, 3.0), rtol=1e-6)
        truth = next(iter(trained().mountings.values()))
        start = truth @ relidar.pose(0.2, -0.2, 0.1, 2, 1.5, -1.66)
        metres, degrees = module.pose_error(module.find_mounting(trained(), log(), start, iterations=80, n_rays=2000), truth)
        self.assertLess(metres, 0.01)
        self.assertLess(degrees, 0.05)

    def test_detector(self):
        trained().save(FOLDER / "examples_run")
        with contextlib.redirect_stdout(io.StringIO()):
            losses, recall, precision = load("torch_detector").main(FOLDER / "examples_run", 24, 20)
        self.assertLess(np.mean(losses[-20:]), 0.6 * np.mean(losses[20:40]))
        self.assertGreater(recall, 0.4)
        self.assertGreater(precision, 0.6)

    def test_detector_scores(self):
        """Two boxes, before and behind the sensor. The network finds the first box, and two wrong objects."""
        module = load("detector", "tools/bench/detector")
        boxes = torch.tensor([[6.8, 0.4, 0], [-9.2, 0.4, 0]])   # centres of the cells 40 and 20
        scan = {"points": torch.zeros(1, 4), "boxes": boxes}
        images = []
        for cells in ((40, 50, 10), (40, 20)):   # in the tested scan, and in the real scan
            images.append(torch.full((1, 64, 64), -9.0))
            images[-1][0, list(cells), 32] = 2
        recall, score, precision, f_score, n = module.score(lambda image: images.pop(0), [scan], [scan])
        expected = torch.tensor([2.0, -9.0]).sigmoid().mean()
        np.testing.assert_allclose((recall, score, precision, f_score, n), (0.5, expected, 0.5, 0.4, 2), rtol=1e-6)

    def test_detector_boxes(self):
        """The sensor looks to the left of the world. A box between two labels is interpolated."""
        module, left = load("detector", "tools/bench/detector"), [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]
        box = {"time_s": [0, 1], "world_from_box": [[0, 5, 0, 1, 0, 0, 0], [2, 9, 1, 1, 0, 0, 0]], "size_m": [4, 2, 1.5]}
        scene = {"lidars": [{"vehicle_from_sensor": [0, 0, 1, 1, 0, 0, 0]}], "boxes": [box, {**box, "time_s": [3, 4]}]}
        poses, sizes = module.read_boxes(scene, {"time_s": 0.5, "world_from_vehicle": [1, 2, 0, *left]})
        np.testing.assert_allclose(poses, [[[0, 1, 0, 5], [-1, 0, 0, 0], [0, 0, 1, -0.5], [0, 0, 0, 1]]], atol=1e-12)
        np.testing.assert_allclose(sizes, [box["size_m"]])


if __name__ == "__main__":
    unittest.main()
