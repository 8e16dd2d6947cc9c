# SPDX-License-Identifier: Apache-2.0
"""Compares forward() and backward() with the double reference. Uses the error measure and the
tolerances of the C++ test (tests/diff/backward, tests/support). A row is a parameter of a surfel.
Its error is |actual - expected| divided by the row's norm. For small rows, it is divided by a share
of the largest norm."""
import os
import re
import subprocess
import unittest

import numpy as np

import relidar
from common import FOLDER, TestCase

PARAMETERS = {"mean": (3,), "rotation": (4,), "log_scale": (2,), "opacity_logit": (), "sh": (3, 16)}
VALUES = ("depth", "weight", "intensity", "hit_logit", "drop_logit", "transmittance", "median_depth")
UPSTREAM = ("depth", "weight", "intensity", "hit_logit", "drop_logit")


def tolerance(name):
    """Returns a constant of tests/support/tolerances.hpp."""
    with open(os.path.join(os.environ["RELIDAR_SOURCE_DIR"], "tests/support/tolerances.hpp")) as file:
        return float(re.search(rf"\b{name} = ([0-9.e-]+);", file.read()).group(1))


def worst_error(expected, actual):
    """Returns the error of GradientGroup::worst_error. Checks that no row with an expected gradient
    is zero."""
    expected, actual = (np.asarray(x, np.float64).reshape(len(x), -1) for x in (expected, actual))
    norms = np.linalg.norm(expected, axis=1)
    bound = tolerance("kSmallRow") * norms.max()
    missing = (norms > bound) & (np.linalg.norm(actual, axis=1) == 0)
    return np.max(np.linalg.norm(actual - expected, axis=1) / np.maximum(norms, bound)) if not missing.any() else np.inf


class Case:
    """Scene of a fixture that is ready for rendering."""

    def __init__(self, direction):
        path = FOLDER / f"gradient_{direction}.npz"
        subprocess.run([os.environ["RELIDAR_GRADIENT_FIXTURE"], path, direction], check=True)
        with np.load(path) as file:
            self.arrays = dict(file)
        a = self.arrays
        self.surfels = {name: a["scene/" + name].reshape(-1, *shape).astype(np.float32) for name, shape in PARAMETERS.items()}
        ranges = zip(a["model/first"].astype(int), a["model/count"].astype(int))
        models = [{"name": f"model {i}", "first": first, "count": count} for i, (first, count) in enumerate(ranges)]
        instances = [{"model": int(m), "track": "" if i == 0 else f"track {i}"} for i, m in enumerate(a["instance/model"])]
        config = relidar.Config("paper", {"image.sh_direction": direction})
        self.renderer = relidar.DifferentiableRenderer(relidar.Scene(self.surfels, models, instances), config, poses=True, rays=True)
        self.poses = np.ascontiguousarray(a["instance/pose"].reshape(-1, 4, 4))
        self.view = a["view_origin"][0]
        self.rays = a["ray/origin"].astype(np.float32), a["ray/direction"].astype(np.float32)
        self.upstream = {name: a["upstream/" + name].astype(np.float32) for name in UPSTREAM}
        self.renderer.place(self.poses, self.view)

    def loss(self):
        rendered = self.renderer.forward(*self.rays)
        return sum(np.dot(rendered[name].astype(np.float64), self.upstream[name]) for name in UPSTREAM)


class Gradient(TestCase):
    def check(self, direction):
        case = Case(direction)
        rendered, expected = case.renderer.forward(*case.rays), case.arrays
        for name in VALUES:
            reference = expected["rendered/" + name]
            nmse = np.sum((rendered[name] - reference) ** 2) / np.sum(reference**2)
            self.assertLessEqual(nmse, tolerance("kKernelNmse"), name)
        np.testing.assert_array_equal(rendered["hits"], expected["rendered/hits"])
        np.testing.assert_array_equal(rendered["instance"], expected["rendered/instance"])

        gradients = case.renderer.backward(case.upstream)
        limit = tolerance("kKernelGradient")
        for name in PARAMETERS:
            reference = expected["gradient/" + name].reshape(gradients[name].shape)
            self.assertTrue(np.any(reference))
            # Separates harmonics by channel, as the C++ test does.
            groups = [reference[:, c] for c in range(3)] if name == "sh" else [reference]
            found = [gradients[name][:, c] for c in range(3)] if name == "sh" else [gradients[name]]
            for r, f in zip(groups, found):
                self.assertLessEqual(worst_error(r, f), limit, f"{name}, SH along {direction}")
        self.assertLessEqual(worst_error(expected["gradient/ray_origin"], gradients["rays"][:, :3]), limit)
        self.assertLessEqual(worst_error(expected["gradient/ray_direction"], gradients["rays"][:, 3:]), limit)
        return case, gradients

    def test_harmonics_along_the_ray(self):
        case, gradients = self.check("ray")
        a = case.arrays
        limit = tolerance("kKernelGradient")
        self.assertLessEqual(worst_error(a["gradient/pose_translation"], gradients["poses"][:, :3]), limit)
        self.assertLessEqual(worst_error(a["gradient/pose_rotation"], gradients["poses"][:, 3:]), limit)
        # Moves all rays together as a rigid body about the view origin.
        turn = np.cross(a["ray/origin"] - case.view, a["gradient/ray_origin"]) + np.cross(a["ray/direction"], a["gradient/ray_direction"])
        self.assertLessEqual(worst_error(a["gradient/ray_origin"].sum(0)[None], gradients["sensor"][None, :3]), limit)
        self.assertLessEqual(worst_error(turn.sum(0)[None], gradients["sensor"][None, 3:]), limit)

    def test_harmonics_along_the_surfel(self):
        self.check("surfel")

    def test_uploaded_parameters_are_rendered(self):
        """Compares the gradient with the difference of the loss over a step along the gradient.
        This check does not use the reference."""
        case = Case("ray")
        case.renderer.forward(*case.rays)
        gradients = case.renderer.backward(case.upstream)
        step = {name: np.float32(1e-3 / np.linalg.norm(gradients[name])) * gradients[name] for name in ("opacity_logit", "sh")}

        def loss_at(sign):
            case.renderer.upload({name: x + sign * step[name] if name in step else x for name, x in case.surfels.items()})
            case.renderer.place(case.poses, case.view)
            return case.loss()

        expected = sum(np.sum(step[name].astype(np.float64) * gradients[name]) for name in step)
        self.assertAlmostEqual((loss_at(1) - loss_at(-1)) / 2, expected, delta=0.02 * expected)
        self.assert_same(case.renderer.download()["mean"], case.surfels["mean"])

    def test_instances_may_be_absent(self):
        case = Case("ray")
        case.renderer.place(present=[True] + [False] * (len(case.poses) - 1))
        self.assertLessEqual(case.renderer.forward(*case.rays)["instance"].max(), 0)

    def test_bad_input(self):
        case = Case("ray")
        origins, directions = case.rays
        forward, backward = case.renderer.forward, case.renderer.backward
        fresh = relidar.DifferentiableRenderer(relidar.Scene(case.surfels))
        self.assert_fails(relidar.UsageError, "place", fresh.forward, origins, directions)
        self.assert_fails(relidar.UsageError, "forward", fresh.backward, {})
        forward(origins, directions)
        doubles, three = origins.astype(float), np.zeros(3, np.float32)
        expected = "origins: found float64 [60,3] ... float32 [n,3]"
        self.assert_fails(relidar.DataError, expected, forward, doubles, directions)
        self.assert_fails(relidar.DataError, "directions: found float32 [3,60]", forward, origins, directions.T)
        self.assert_fails(relidar.DataError, "C order", forward, np.asfortranarray(origins), directions)
        self.assert_fails(relidar.DataError, "C order", forward, origins[::2], directions[::2])
        self.assert_fails(relidar.DataError, "found 59 directions and 60 origins", forward, origins, directions[:59])
        self.assert_fails(relidar.DataError, "type list", forward, origins.tolist(), directions)
        self.assert_fails(relidar.DataError, ">f4", forward, origins.astype(">f4"), directions)
        self.assert_fails(relidar.DataError, "depth: found float32 [3] ... float32 [60]", backward, {"depth": three})
        self.assert_fails(relidar.UsageError, 'd_rendered ... "range"', backward, {"range": np.zeros(60, np.float32)})
        self.assert_fails(relidar.DataError, "poses: found 1 entries, expected 3", case.renderer.place, np.eye(4)[None])
        self.assert_fails(relidar.DataError, "view_origin: found float32", case.renderer.place, None, three)
        overlapping = relidar.Scene(case.surfels, [{"name": "a", "first": 0, "count": 10**6}])
        self.assert_fails(relidar.DataError, "", relidar.DifferentiableRenderer, overlapping)


if __name__ == "__main__":
    unittest.main()
