# SPDX-License-Identifier: Apache-2.0
"""Compares forward() with sums by hand, and backward() with differences of the loss over small
steps. The C++ tests (tests/diff) compare the same kernels with the double reference."""
import unittest

import numpy as np

import relidar
from common import TestCase

UPSTREAM = ("depth", "weight", "intensity", "hit_logit", "drop_logit")
STEP = 3e-4     # length of a step, short enough that few rays meet another order of surfels
LIMIT = 0.02    # of the expected difference


def rotation(w):
    """Returns the matrix that rotates by |w| radians about the axis w."""
    k = np.array([[0, -w[2], w[1]], [w[2], 0, -w[0]], [-w[1], w[0], 0]])
    angle = np.linalg.norm(w)
    return np.eye(3) + np.sinc(angle / np.pi) * k + 0.5 * np.sinc(angle / 2 / np.pi) ** 2 * k @ k


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def two_surfels():
    """Returns two surfels that face a ray along the x axis at 5 m and 7 m."""
    return {"mean": np.float32([[5, 0, 0], [7, 0, 0]]), "rotation": np.full((2, 4), 0.5, np.float32), "log_scale": np.zeros((2, 2), np.float32),
            "opacity_logit": np.float32([0.5, -0.5]), "sh": np.zeros((2, 3, 16), np.float32)}


class Case:
    """Background and instances of an actor in front of a sensor, and the gradient of a random loss.
    With spherical harmonics along the surfel, only the first instance of a model defines the
    direction, so the actor has a single instance."""

    def __init__(self, direction, deterministic=False):
        random = np.random.default_rng(32)
        surfels = {"mean": np.c_[random.uniform(4, 8, 32), random.uniform(-1, 1, (32, 2))], "rotation": random.normal(size=(32, 4)),
                   "log_scale": random.uniform(-1.2, -0.3, (32, 2)), "opacity_logit": random.normal(size=32),
                   "sh": 0.3 * random.normal(size=(32, 3, 16))}
        surfels["mean"][20:, 0] -= 6
        self.surfels = {name: array.astype(np.float32) for name, array in surfels.items()}
        models = [{"name": "background", "first": 0, "count": 20}, {"name": "actor", "first": 20, "count": 12}]
        instances = [{"model": 0, "track": ""}, {"model": 1, "track": "a"}, {"model": 1, "track": "b"}][: 3 if direction == "ray" else 2]
        self.poses = np.stack([np.eye(4), relidar.pose(5, 0.3, 0.1, 40, 10, 5), relidar.pose(7, -0.4, -0.2, 200, 0, 3)])[: len(instances)]
        self.view = np.array([0.1, -0.2, 0.1])
        origins = self.view + 0.05 * random.normal(size=(40, 3))
        directions = unit(np.c_[np.ones(40), random.uniform(-0.15, 0.15, (40, 2))])
        self.rays = origins.astype(np.float32), directions.astype(np.float32)
        self.upstream = {name: random.uniform(0.5, 1.5, 40).astype(np.float32) for name in UPSTREAM}
        self.config = relidar.Config("paper", {"image.sh_direction": direction, "train.deterministic": deterministic, "loss.likelihood": 1})
        self.model = relidar.Scene(self.surfels, models, instances)
        self.renderer = relidar.DifferentiableRenderer(self.model, self.config, poses=True, rays=True)
        self.renderer.place(self.poses, self.view)
        self.renderer.forward(*self.rays)
        self.gradients = self.renderer.backward(self.upstream)

    def loss(self, surfels=None, poses=None, origins=None, directions=None):
        self.renderer.upload(self.surfels if surfels is None else surfels)
        self.renderer.place(self.poses if poses is None else poses, self.view)
        rays = (self.rays[0] if origins is None else origins, self.rays[1] if directions is None else directions)
        rendered = self.renderer.forward(*(np.ascontiguousarray(array, np.float32) for array in rays))
        return sum(np.dot(rendered[name].astype(np.float64), self.upstream[name]) for name in UPSTREAM)


class Gradient(TestCase):
    def check(self, what, case, gradient, moved):
        """Compares the gradient with the difference of the loss over a step along the gradient.
        moved(step) returns the changed arguments of Case.loss()."""
        gradient = gradient.astype(np.float64)
        step = STEP / np.linalg.norm(gradient) * gradient
        difference = (case.loss(**moved(step)) - case.loss(**moved(-step))) / 2
        expected = np.sum(step * gradient)
        self.assertAlmostEqual(difference, expected, delta=LIMIT * expected, msg=what)

    def check_all(self, direction):
        case = Case(direction)
        gradients, (origins, directions) = case.gradients, case.rays
        for name, array in case.surfels.items():
            self.assertEqual(gradients[name].shape, array.shape)
            self.check(name, case, gradients[name], lambda step: {"surfels": dict(case.surfels, **{name: (array + step).astype(np.float32)})})
        d_origin, d_direction = gradients["rays"][:, :3], gradients["rays"][:, 3:]
        self.check("origin", case, d_origin, lambda step: {"origins": origins + step})
        along = np.sum(d_direction * directions, axis=1, keepdims=True) * directions
        self.check("direction", case, d_direction - along, lambda step: {"directions": unit(directions + step)})

        def moved(step):
            poses = case.poses.copy()
            for pose, (v, w) in zip(poses, step.reshape(-1, 2, 3)):
                pose[:3, 3] += v
                pose[:3, :3] = rotation(w) @ pose[:3, :3]
            return {"poses": poses}

        for name, axes in (("translation", slice(0, 3)), ("rotation", slice(3, 6))):
            part = np.zeros_like(gradients["poses"])
            part[1:, axes] = gradients["poses"][1:, axes]
            self.check(name, case, part, moved)
        if direction == "ray":   # all rays move together as a rigid body about the view origin
            turn = np.cross(origins - case.view, d_origin) + np.cross(directions, d_direction)
            expected = np.r_[d_origin.sum(0), turn.sum(0)]
            np.testing.assert_allclose(gradients["sensor"], expected, atol=1e-3 * np.linalg.norm(expected))
        case.loss()
        self.assert_same(case.renderer.download()["mean"], case.surfels["mean"])

    def test_harmonics_along_the_ray(self):
        self.check_all("ray")

    def test_harmonics_along_the_surfel(self):
        self.check_all("surfel")

    def test_two_surfels_by_hand(self):
        surfels = two_surfels()
        surfels["sh"][:, :, 0] = [[1, 2, -1], [0.5, -1, 1]]
        renderer = relidar.DifferentiableRenderer(relidar.Scene(surfels), relidar.Config("paper"))
        renderer.place()
        rendered = renderer.forward(np.zeros((1, 3), np.float32), np.float32([[1, 0, 0]]))
        alpha = 1 / (1 + np.exp(-surfels["opacity_logit"].astype(float)))
        w = np.array([alpha[0], (1 - alpha[0]) * alpha[1]])
        channels = 0.5 + np.sqrt(0.25 / np.pi) * surfels["sh"][:, :, 0].astype(float)
        rest = 1 - w.sum()
        expected = {"depth": w @ [5, 7], "weight": w.sum(), "intensity": w @ channels[:, 0], "hit_logit": w @ channels[:, 1],
                    "drop_logit": w @ channels[:, 2] + rest, "transmittance": rest, "median_depth": 5, "hits": 2, "instance": 0}
        self.assertEqual(set(rendered), set(expected))
        for name, value in expected.items():
            np.testing.assert_allclose(rendered[name], [value], rtol=1e-5, err_msg=name)

    def test_unused_harmonics_have_no_gradient(self):
        """Memory of gradients that another renderer has used."""
        for direction in "surfel", "ray":
            case = Case(direction)
            case.renderer = None
            lower = relidar.DifferentiableRenderer(case.model, relidar.Config("paper", {"image.sh_direction": direction, "image.sh_degree": 1}))
            lower.place(case.poses, case.view)
            lower.forward(*case.rays)
            gradient = lower.backward(case.upstream)["sh"]
            self.assertTrue(gradient[:, :, :4].any())
            self.assertFalse(gradient[:, :, 4:].any())

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
        expected = "origins: found float64 [40,3] ... float32 [n,3]"
        self.assert_fails(relidar.DataError, expected, forward, doubles, directions)
        self.assert_fails(relidar.DataError, "directions ... [3,40]", forward, origins, directions.T)
        self.assert_fails(relidar.DataError, "C order", forward, np.asfortranarray(origins), directions)
        self.assert_fails(relidar.DataError, "C order", forward, origins[::2], directions[::2])
        self.assert_fails(relidar.DataError, "39 directions ... 40", forward, origins, directions[:39])
        self.assert_fails(relidar.DataError, "ray 0 ... length 1", forward, origins, 3 * directions)
        self.assert_fails(relidar.DataError, "ray 0 ... finite", forward, np.nan * origins, directions)
        self.assert_fails(relidar.DataError, "list", forward, origins.tolist(), directions)
        self.assert_fails(relidar.DataError, ">f4", forward, origins.astype(">f4"), directions)
        self.assert_fails(relidar.DataError, "depth ... float32 [3] ... float32 [40]", backward, {"depth": three})
        self.assert_fails(relidar.UsageError, 'd_rendered ... "range"', backward, {"range": np.zeros(40, np.float32)})
        self.assert_fails(relidar.DataError, "poses ... 1 ... 3", case.renderer.place, np.eye(4)[None])
        self.assert_fails(relidar.DataError, "view_origin ... float32", case.renderer.place, None, three)
        overlapping = relidar.Scene(case.surfels, [{"name": "a", "first": 0, "count": 10**6}])
        self.assert_fails(relidar.DataError, "", relidar.DifferentiableRenderer, overlapping)


if __name__ == "__main__":
    unittest.main()
