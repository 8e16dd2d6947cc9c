# SPDX-License-Identifier: Apache-2.0
"""Losses of train() that are Python functions, compared with the same loss of the library."""
import sys
import unittest
from unittest import mock

import numpy as np

import relidar
from common import FOLDER, TestCase, config, log

try:
    import torch
except ModuleNotFoundError:
    torch = None
    print("skipped: losses with autograd need torch")

WEIGHT = 0.125


def settings(depth=0.0, **others):
    changed = config().copy()
    for key, value in {"loss.depth": depth, "loss.normalised_depth": False, "train.deterministic": True, "refine.enabled": False,
                       "train.rays_per_iteration": 2000, **others}.items():
        changed[key] = value
    return changed


def train(depth=0.0, losses=(), **arguments):
    """Returns the trained surfels and the last line of the log."""
    lines = []
    trained = relidar.train(log(), settings(depth, **arguments.pop("settings", {})), losses=losses, callback=lines.append, **arguments)
    return trained.scene.surfels, lines[-1]


def scale(batch):
    """Returns the weight of a ray, rounded as in the library."""
    return np.float32(np.float32(WEIGHT) * np.float32(1 / batch.n_returned))


class Losses(TestCase):
    def assert_same_training(self, losses, device=None):
        surfels, line = train(losses=losses, device=device)
        expected, expected_line = train(WEIGHT)
        for name in expected:
            self.assert_same(surfels[name], expected[name])
        self.assertEqual(line.terms["depth"], 0)
        np.testing.assert_allclose(line.terms["custom"], expected_line.terms["depth"], rtol=1e-5)

    @unittest.skipUnless(torch, "needs torch")
    def test_a_tensor_trains_like_the_loss_of_the_library(self):
        def range_loss(batch):
            known = (batch.measured["weight"] > 0) & (batch.measured["range"] > 0)
            error = torch.where(known, batch.rendered["depth"] - batch.measured["range"], torch.zeros(1))
            return (error.abs() * float(scale(batch))).sum()

        self.assert_same_training([range_loss])
        self.assert_same_training([range_loss], relidar.Device(share_memory=False))   # with copies

    def test_gradients_by_hand_without_torch(self):
        def range_loss(batch):
            known = (batch.measured["weight"] > 0) & (batch.measured["range"] > 0)
            error = np.where(known, batch.rendered["depth"] - batch.measured["range"], np.float32(0))
            batch.gradients["depth"] += scale(batch) * np.sign(error)
            return float(scale(batch)) * np.abs(error).sum(dtype=np.float64)

        with mock.patch.dict(sys.modules, {"torch": None}):
            self.assert_same_training([lambda batch: 0, range_loss])

    def test_the_batch(self):
        """Rays, measurement and rendering belong together. Nothing is copied through the host."""
        seen, device = [], relidar.Device()

        def look(batch):
            directions, ranges = np.asarray(batch.rays["directions"]), np.asarray(batch.measured["range"])
            depth, weight = (np.array(batch.rendered[name].tolist()) for name in ("depth", "weight"))
            self.assertEqual(ranges.shape, depth.shape)
            self.assertEqual(batch.shape[0] * batch.shape[1], len(depth))
            np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1, atol=1e-5)
            known = np.asarray(batch.measured["weight"]) > 0
            returned = known & (ranges > 0)
            np.testing.assert_allclose((known.sum(), returned.sum()), (batch.n_known, batch.n_returned), rtol=0.1)
            hit = returned & (weight > 0.5)
            seen.append(np.median(np.abs(depth / np.maximum(weight, 0.1) - ranges)[hit]))
            return 0.0

        train(0.1, [look], device=device)
        self.assertEqual(len(seen), 30)
        self.assertLess(seen[-1], 0.5)   # metres
        plain = relidar.Device()
        train(0.1, device=plain)
        copies = ("upload_bytes", "download_bytes", "staged_bytes")
        self.assertEqual([device.transfers[c] for c in copies], [plain.transfers[c] for c in copies])

    def test_the_likelihood_of_the_settings(self):
        """-ln(f + (1 - f) S) of the batch, and its derivative, are those of the loss `likelihood`."""
        seen = []

        def look(batch):
            hit = (np.asarray(batch.measured["weight"]) > 0) & (np.asarray(batch.measured["range"]) > 0)
            explained = 0.01 + 0.99 * np.array(batch.rendered["likelihood"].tolist())
            expected = np.where(hit, -WEIGHT * 0.99 / batch.n_returned / explained, 0)
            np.testing.assert_allclose(np.asarray(batch.gradients["likelihood"]), expected, rtol=1e-4)
            seen.append(-WEIGHT * np.log(explained[hit]).sum() / batch.n_returned)
            return 0.0

        _, line = train(losses=[look], settings={"loss.likelihood": WEIGHT})
        self.assertAlmostEqual(line.terms["likelihood"], np.mean(seen[-5:]), delta=1e-4 * seen[-1])   # of a line of the log

    def test_an_exception_ends_training_and_keeps_checkpoints(self):
        folder, steps = FOLDER / "loss_checkpoints", []

        def loss(batch):
            steps.append(1)
            if len(steps) == 12:
                raise KeyError("mine")
            return 0.0

        named = {"checkpoints": folder, "settings": {"train.checkpoint_minutes": 1e-9}}
        with self.assertRaisesRegex(KeyError, "mine"):
            train(0.1, [loss], **named)
        _, line = train(0.1, [loss], resume=True, **named)
        self.assertEqual((len(steps), line.iteration), (12 + 30 - 11, 30))

    def test_wrong_results(self):
        results = [None, "1", [1.0], np.zeros(2)]
        if torch:
            results += [torch.zeros(1), torch.zeros(2, requires_grad=True)]
        for result in results:
            self.assert_fails(relidar.UsageError, "", train, 0.1, [lambda batch: result])
        self.assert_fails(relidar.DataError, "custom", train, 0.1, [lambda batch: float("nan")])
        with self.assertRaises(TypeError):
            train(0.1, [3])
