# SPDX-License-Identifier: Apache-2.0
"""relidar.torch and DeviceArray. Values and gradients equal those of DifferentiableRenderer to the bit.
Gradients of what PyTorch computes around it are compared with differences of the loss."""
import concurrent.futures
import gc
import importlib.util
import subprocess
import sys
import unittest
import warnings
from unittest import mock

import numpy as np

import relidar
from common import TestCase, log, run
from gradient_test import LIMIT, STEP, UPSTREAM, Case, two_surfels

if importlib.util.find_spec("torch"):
    import torch
else:
    print("skipped: torch_test.py, because PyTorch is not installed")


class Arrays(TestCase):
    def setUp(self):
        self.case = Case("ray")
        self.array = self.case.renderer.device_parameters()["rotation"]

    def test_numpy_uses_the_memory_of_a_cpu_device(self):
        device = relidar.Device(share_memory=False)
        if device.info.type != "CPU":
            self.skipTest("the device is no CPU")
        view = self.array.numpy()
        self.assertEqual((self.array.shape, self.array.dtype, self.array.strides), (view.shape, view.dtype, view.strides))
        self.assertEqual(self.array.__dlpack_device__(), (1, 0))
        self.assert_same(np.from_dlpack(self.array), view)
        self.assertEqual(np.from_dlpack(self.array).__array_interface__["data"][0], view.__array_interface__["data"][0])
        view[3] = [1, 2, 3, 4]
        self.assert_same(self.case.renderer.download()["rotation"][3], np.float32([1, 2, 3, 4]))
        copies = relidar.DifferentiableRenderer(relidar.Scene(self.case.surfels), device=device).device_parameters()["mean"]
        self.assertFalse(copies.is_shared)
        copies.numpy()[:] = 0
        self.assert_same(copies.numpy(), self.case.surfels["mean"])

    def test_members_of_structs_have_strides(self):
        origins, directions = self.case.rays
        for share in True, False:
            renderer = relidar.DifferentiableRenderer(relidar.Scene(self.case.surfels), relidar.Config("paper"),
                                                      device=relidar.Device(share_memory=share))
            renderer.place()
            expected = renderer.forward(origins, directions)
            time = np.full((len(origins), 1), 3e38, np.float32)
            renderer.device_rays(len(origins)).copy_from(np.hstack([origins, directions, time]))
            rendered = renderer.forward_device(len(origins))
            for name, values in expected.items():
                self.assert_same(rendered[name].numpy().view(values.dtype), values)
            rendered["depth"].copy_from(np.zeros(len(origins), np.float32))
            self.assertFalse(rendered["depth"].numpy().any())
            self.assert_same(rendered["weight"].numpy(), expected["weight"])

    def test_outlives_the_renderer_and_the_device(self):
        device = relidar.Device()
        renderer = relidar.DifferentiableRenderer(relidar.Scene(self.case.surfels), device=device)
        array = renderer.device_parameters()["mean"]
        view = array.numpy()
        del renderer, device, array
        gc.collect()
        other = relidar.DifferentiableRenderer(relidar.Scene(self.case.surfels))
        self.assert_same(view.copy(), self.case.surfels["mean"])
        del other

    def test_bad_input(self):
        self.assert_fails(relidar.DataError, "found float64 [32,4] ... float32 [32,4]", self.array.copy_from, np.zeros((32, 4)))
        self.assert_fails(relidar.DataError, "found float32 [32] ... [32,4]", self.array.copy_from, np.zeros(32, np.float32))
        self.assert_fails(relidar.DataError, "list ... float32 [32,4]", self.array.copy_from, [1, 2])
        renderer = self.case.renderer
        self.assert_fails(relidar.UsageError, "cannot render 9000 rays", renderer.forward_device, 9000)
        renderer.device_rays(40)
        self.assert_fails(relidar.UsageError, "3 columns", renderer.forward_device, 40, 3)
        fresh = relidar.DifferentiableRenderer(relidar.Scene(self.case.surfels))
        self.assert_fails(relidar.UsageError, "forward", fresh.backward_device)
        with self.assertRaises(BufferError):
            self.array.__dlpack__(copy=True)

    def test_without_pytorch(self):
        program = ("import sys; sys.modules['torch'] = None\nimport relidar\ntry: relidar.torch\n"
                   "except ModuleNotFoundError as error: sys.exit(0 if error.name == 'torch' and 'PyTorch' in str(error) else 1)\nsys.exit(2)")
        self.assertEqual(subprocess.run([sys.executable, "-B", "-c", program]).returncode, 0)
        program = "import sys, relidar; sys.exit('torch' in sys.modules)"
        self.assertEqual(subprocess.run([sys.executable, "-B", "-c", program]).returncode, 0)


class TorchCase(Case):
    """The same scene, in a Scene of relidar.torch and in a DifferentiableRenderer."""

    def __init__(self, direction="ray", device=None, training=False):
        super().__init__(direction, deterministic=True)
        self.scene = relidar.torch.Scene(self.model, self.config, poses=True, rays=True, training=training, device=device)
        self.tensor = torch.from_numpy(np.hstack(self.rays))

    def expected(self, surfels=None, rays=None, view=None):
        """Returns values and gradients of the DifferentiableRenderer."""
        rays = self.rays if rays is None else rays
        self.renderer.upload(surfels or self.surfels)
        self.renderer.place(self.poses, torch.from_numpy(rays[0]).mean(0).double().numpy() if view is None else view)
        upstream = {name: np.ascontiguousarray(array[: len(rays[0])]) for name, array in self.upstream.items()}
        return self.renderer.forward(*rays), self.renderer.backward(upstream)

    def render(self, rays=None, **arguments):
        return relidar.torch.render(self.scene, self.tensor if rays is None else rays, **{"poses": self.poses, **arguments})

    def loss_of(self, out):
        return sum((out[name] * torch.from_numpy(self.upstream[name][: len(out[name])])).double().sum() for name in UPSTREAM)


@unittest.skipUnless(importlib.util.find_spec("torch"), "PyTorch is not installed")
class Torch(TestCase):
    STORED = {"means": "mean", "quats": "rotation", "log_scales": "log_scale", "opacity_logits": "opacity_logit", "features": "sh"}

    def check_equal(self, out, expected):
        for name, values in expected.items():
            self.assert_same(out[name].detach().numpy().view(values.dtype), values)

    def check_backward(self, case, out, gradients):
        case.loss_of(out).backward()
        for name, stored in self.STORED.items():
            gradient = getattr(case.scene, name).grad
            if gradient.is_sparse:   # of the surfels that were hit
                np.testing.assert_array_equal(gradient._indices()[0].numpy(), np.flatnonzero(gradients["touched"]))
                gradient = gradient.to_dense()
            self.assert_same(gradient.numpy(), gradients[stored])
            getattr(case.scene, name).grad = None

    def test_equals_the_renderer(self):
        for device in None, relidar.Device(share_memory=False):
            for direction in "ray", "surfel":
                with warnings.catch_warnings(record=True) as caught:
                    warnings.simplefilter("always")
                    case = TorchCase(direction, device)
                self.assertEqual(len(caught), int(device is not None))
                values, gradients = case.expected()
                rays = case.tensor.clone().requires_grad_()
                out = case.render(rays)
                self.check_equal(out, values)
                self.check_backward(case, out, gradients)
                self.assert_same(rays.grad.numpy(), gradients["rays"])

    def test_earlier_batches_are_rendered_again(self):
        case = TorchCase()
        other = tuple(np.ascontiguousarray(array[::-1][:17]) for array in case.rays)
        batches = case.render([case.tensor, tuple(torch.from_numpy(array) for array in other)], poses=np.stack([case.poses] * 2))
        for out, rays in zip(batches, (case.rays, other)):
            values, gradients = case.expected(rays=rays)
            self.check_equal(out, values)
            self.check_backward(case, out, gradients)
        out = case.render()
        self.assert_fails(relidar.DataError, "present", case.render, rays=case.tensor[:17].flip(0), present=[True])
        self.check_backward(case, out, case.expected()[1])   # a failed call has changed the rays

    def test_threads_share_a_scene(self):
        case = TorchCase()
        batches = [case.tensor, case.tensor.flip(0)[:17]]
        expected = [case.render(rays)["depth"] for rays in batches]
        with concurrent.futures.ThreadPoolExecutor(2) as pool:
            for i, out in enumerate(pool.map(case.render, batches * 20)):
                self.assertTrue(torch.equal(out["depth"], expected[i % 2]))

    def test_two_scenes_and_changes_in_place(self):
        first, second = TorchCase(), TorchCase()
        out = first.render()
        second.render(second.tensor[:5])
        self.check_backward(first, out, first.expected()[1])
        with torch.no_grad():
            first.scene.means += 0.1
        moved = dict(first.surfels, mean=first.surfels["mean"] + np.float32(0.1))
        self.assert_same(first.scene.surfels()["mean"], moved["mean"])
        out = first.render()
        self.check_equal(out, first.expected(moved)[0])
        self.check_equal(second.render(), second.expected()[0])
        first.render(means=torch.zeros(32, 3), scales=torch.ones(32, 2))   # only in this call
        self.assert_same(first.scene.means.detach().numpy(), moved["mean"])
        self.check_backward(first, out, first.expected(moved)[1])
        first.scene.means = torch.nn.Parameter(torch.from_numpy(moved["mean"] + np.float32(0.1)))
        self.check_equal(first.render(), first.expected(first.scene.surfels())[0])
        first.scene.means = torch.nn.Parameter(torch.from_numpy(moved["mean"]))
        self.check_equal(first.render(), first.expected(moved)[0])
        out = first.render()
        with torch.no_grad():
            first.scene.means += 0.1
        with self.assertRaisesRegex(RuntimeError, "modified by an inplace operation"):
            first.loss_of(out).backward()

    def check_step(self, name, loss, tensor, length=STEP):
        """Compares dL/d(tensor) with the difference of the loss over a step along the gradient."""
        tensor = tensor.detach().clone().requires_grad_()
        loss(tensor).backward()
        step = tensor.grad * (length / tensor.grad.double().norm())
        with torch.no_grad():
            difference = (loss(tensor + step) - loss(tensor - step)) / 2
        expected = float((step.double() * tensor.grad.double()).sum())
        self.assertAlmostEqual(float(difference), expected, delta=LIMIT * expected, msg=name)

    def test_differences(self):
        """What PyTorch computes around the kernels: activations, motions, and the frame of the sensor."""
        for direction in "ray", "surfel":
            case = TorchCase(direction)
            scene, poses, sensor = case.scene, torch.from_numpy(case.poses), torch.from_numpy(relidar.pose(0.1, -0.2, 0.1, 5, 3, 2))
            turn, shift = sensor[:3, :3].float(), sensor[:3, 3].float()
            origins, directions = (torch.from_numpy(array) for array in case.rays)
            origins, directions = (origins - shift) @ turn, directions @ turn

            def loss(rays=(origins, directions), **arguments):
                return case.loss_of(case.render(rays, **{"sensor": sensor, **arguments}))

            motion = torch.zeros(6, dtype=torch.float64, requires_grad=True)
            loss(sensor=relidar.torch.move(sensor, motion)).backward()
            world = (origins @ turn.T + shift).numpy(), (directions @ turn.T).numpy()
            expected = case.expected(rays=world, view=sensor[:3, 3].numpy().copy())[1]["sensor"]
            np.testing.assert_allclose(motion.grad.numpy(), expected, rtol=1e-5)
            motion.grad = None
            if direction == "ray":   # the same as a motion of every ray; `surfel` also depends on the view origin
                moved = relidar.torch.move(sensor, motion).float()
                loss((origins @ moved[:3, :3].T + moved[:3, 3], directions @ moved[:3, :3].T), sensor=None).backward()
                np.testing.assert_allclose(motion.grad.numpy(), expected, rtol=1e-4)
                self.check_step("origins", lambda x: loss((x, directions)), origins)
            self.check_step("directions", lambda x: loss((origins, x / x.norm(dim=1, keepdim=True))), directions)
            rows = torch.tensor([0.0] + [1.0] * (len(poses) - 1), dtype=torch.float64)[:, None]
            for axes in ([1, 1, 1, 0, 0, 0], [0, 0, 0, 1, 1, 1]):
                self.check_step(f"poses {axes}", lambda m: loss(poses=relidar.torch.move(poses, m * rows * torch.tensor(axes))),
                                torch.zeros(len(poses), 6, dtype=torch.float64))
            self.check_step("factor", lambda x: loss(means=scene.means * x), torch.tensor([1.01, 0.99, 1.0]))
            for name in "means", "quats", "scales", "opacities", "features":
                self.check_step(name, lambda x: loss(**{name: x}), getattr(scene, name))

    def test_likelihood_by_hand(self):
        """The hits are at 5 m and 7 m, and the range 5.02 m was measured."""
        surfels = relidar.Scene(two_surfels())
        scene, scale = relidar.torch.Scene(surfels, relidar.Config("paper", {"loss.likelihood": 1})), 0.05
        self.assertAlmostEqual(scene.renderer.likelihood_scale_m, scale)
        rays = torch.tensor([[0.0, 0, 0, 1, 0, 0]] * 2)
        out = relidar.torch.render(scene, rays, measured=torch.tensor([5.02, 0]))
        alpha = 1 / (1 + np.exp([-0.5, 0.5]))
        weight, error = np.array([alpha[0], (1 - alpha[0]) * alpha[1]]), np.array([5, 7]) - 5.02
        kernel = 1 / (1 + (error / scale) ** 2)
        np.testing.assert_allclose(out["likelihood"].detach().numpy(), [weight @ kernel, 0], rtol=1e-5)
        out["likelihood"].sum().backward()
        np.testing.assert_allclose(scene.means.grad[:, 0].numpy(), -2 * weight * error / scale**2 * kernel**2, rtol=1e-4)
        slopes = np.array([kernel[0] - alpha[1] * kernel[1], (1 - alpha[0]) * kernel[1]]) * alpha * (1 - alpha)
        np.testing.assert_allclose(scene.opacity_logits.grad.numpy(), slopes, rtol=1e-4)
        self.assertNotIn("likelihood", relidar.torch.render(scene, rays))
        without = relidar.torch.Scene(surfels, relidar.Config("paper"))
        self.assertRaises(relidar.UsageError, relidar.torch.render, without, rays, measured=torch.ones(2))

    def test_likelihood_is_rendered_again(self):
        """With the measured ranges of its batch, after another batch was rendered."""
        case = TorchCase()
        measured = case.render()["median_range"].detach() + 0.02

        def loss(rays=case.tensor):
            return case.render(rays, measured=measured)["likelihood"].double().sum()

        again = loss()
        loss(case.tensor.flip(0))
        self.assertTrue(torch.equal(*(torch.autograd.grad(each, case.scene.means)[0] for each in (again, loss()))))

    def test_training_scene(self):
        """Sparse gradients equal dense gradients. The tree is updated only after large changes, which changes no value."""
        for direction in "ray", "surfel":
            case = TorchCase(direction, training=True)
            out = case.render()
            values, gradients = case.expected()
            self.check_equal(out, values)
            self.check_backward(case, out, gradients)
            scales = case.scene.scales.detach().requires_grad_()
            case.loss_of(case.render(scales=scales)).backward()   # dense, because it belongs to log(scales)
            np.testing.assert_allclose(scales.grad.numpy() * scales.detach().numpy(), gradients["log_scale"], rtol=1e-4, atol=1e-6)
            place, refits = relidar.DifferentiableRenderer.place, []

            def note_refit(renderer, *arguments, **named):
                refits.extend(named.values())
                place(renderer, *arguments, **named)

            with mock.patch.object(relidar.DifferentiableRenderer, "place", note_refit):
                for name, change in (("means", 0.002), ("means", 0.002), ("log_scales", 0.04), ("log_scales", 0.04),
                                     ("quats", 0.001), ("quats", 0.1), ("opacity_logits", 0.2), ("opacity_logits", 0.2)):
                    with torch.no_grad():
                        getattr(case.scene, name)[-1] += change
                    self.check_equal(case.render(), case.expected(case.scene.surfels())[0])
            self.assertEqual(refits, 4 * [False, True])

    def test_adam(self):
        """Equal to SparseAdam of PyTorch, with other rows in each step."""
        torch.manual_seed(1)
        for shape in (50, 3, 16), (50,):
            actual, expected = (torch.zeros(shape, requires_grad=True) for _ in range(2))
            optimisers = relidar.torch.Adam([actual], lr=0.1), torch.optim.SparseAdam([expected], lr=0.1, eps=1e-15)
            for step in range(6):
                rows = torch.randperm(50)[:20].sort()[0]
                gradient = torch.sparse_coo_tensor(rows[None], torch.randn(20, *shape[1:]), shape)
                expected.grad, actual.grad = gradient, gradient.to_dense() if step == 3 else gradient
                for optimiser in optimisers:
                    optimiser.step()
            actual.grad = torch.zeros(shape)   # no ray has hit a surfel
            optimisers[0].step()
            torch.testing.assert_close(actual, expected)
        factors = torch.zeros(3, 16)
        factors[0, :4], factors[1, 1] = 0.5, 1
        part = torch.zeros(50, 3, 16, requires_grad=True)
        for values, group in ((part, {"factors": factors}), (actual := torch.zeros(50, 3, 16, requires_grad=True), {})):
            values.grad = torch.linspace(-1, 1, 2400).view(50, 3, 16)
            relidar.torch.Adam([{"params": [values], **group}]).step()
        torch.testing.assert_close(part, actual * factors)
        row = torch.zeros(50, requires_grad=True)
        for factor, expected in ((0.0, 0.0), (0.5, -0.0005)):   # a row has a single number
            row.grad = torch.ones(50)
            relidar.torch.Adam([{"params": [row], "factors": torch.tensor(factor)}]).step()
            torch.testing.assert_close(row, torch.full((50,), expected))
        self.assert_fails(relidar.DataError, "factors: ... [3, 1]", relidar.torch.Adam([{"params": [part], "factors": torch.ones(3, 1)}]).step)

    def test_gradcheck(self):
        motion = torch.zeros(2, 6, dtype=torch.float64, requires_grad=True)
        poses = torch.from_numpy(np.stack([relidar.pose(1, 2, 3, 10, 20, 30), relidar.pose(-1, 0, 2, 50)]))
        torch.autograd.gradcheck(lambda m: relidar.torch.move(poses, m)[..., :3, :], motion)
        for _, inverse in relidar.torch._ACTIVATED.values():
            torch.autograd.gradcheck(inverse, torch.tensor([0.1, 0.8], dtype=torch.float64, requires_grad=True))
        # The gradient of poses gives the same derivative for every small motion.
        d_motion, centre = torch.randn(2, 6, dtype=torch.float64), torch.randn(2, 3, dtype=torch.float64)
        about = torch.cat([d_motion[:, :3], d_motion[:, 3:] + torch.cross(centre, d_motion[:, :3], dim=1)], 1)
        for gradient, expected in ((relidar.torch._pose_gradient(poses, d_motion), d_motion),
                                   (relidar.torch._pose_gradient(poses, d_motion, centre), about)):
            actual = torch.autograd.grad((relidar.torch.move(poses, motion) * gradient).sum(), motion)
            torch.testing.assert_close(actual, (expected,))

    def test_training_copies_nothing(self):
        """A run of the street: values of frames, a falling loss, no copies through the host."""
        scene = relidar.torch.Scene.from_run(run())
        frames = [relidar.torch.Frame(run(), log(), position) for position in range(3)]
        optimiser = torch.optim.Adam([{"params": [scene.means], "lr": 1e-3}, {"params": [scene.opacity_logits, scene.features], "lr": 5e-2}])
        losses = []
        for step in range(8):
            if step == 1:
                before = scene.renderer.device_parameters()["mean"].numpy().copy()
                counts = scene.renderer.device.transfers
            total = 0.0
            for frame in frames:
                out = relidar.torch.render(scene, frame)
                hit = (frame.range > 0) & (frame.weight > 0)
                total += (out["range"] - frame.range)[hit].abs().mean() + (out["intensity"] - frame.intensity)[hit].abs().mean()
            optimiser.zero_grad()
            total.backward()
            optimiser.step()
            losses.append(float(total))
        self.assertLess(losses[-1], losses[0])
        after = scene.renderer.device.transfers
        if scene.device.type == "cpu" and scene.renderer.device_parameters()["mean"].is_shared:
            for name in ("uploads", "upload_bytes", "downloads", "download_bytes"):
                self.assertEqual(after[name], counts[name], name)
        self.assertGreater(np.abs(scene.renderer.device_parameters()["mean"].numpy() - before).max(), 0)
        improved = run().with_surfels(scene.surfels())
        self.assert_same(improved.surfels["mean"], scene.surfels()["mean"])

    def test_a_frame_is_the_scan_of_the_log(self):
        frame = relidar.torch.Frame(run(), log(), 2)
        scan = log().scan(2)
        self.assertEqual(frame.shape, scan["range"].shape)
        np.testing.assert_allclose(frame.view_origin + run().world_offset, run().trajectory[1][2][:3, 3], atol=1e-6)
        self.assert_same(frame.range.numpy() > 0, scan["range"].ravel() > 0)
        rendered = run().render(time=run().times[2])
        out = relidar.torch.render(relidar.torch.Scene.from_run(run()), frame)
        seen = rendered["weight"].ravel() > 0.5
        np.testing.assert_allclose(out["median_range"].detach().numpy()[seen], rendered["median_range"].ravel()[seen], rtol=1e-4, atol=1e-3)
        with self.assertRaises(relidar.UsageError):
            relidar.torch.render(relidar.torch.Scene.from_run(run()), frame, present=[True])

    def test_poses_replace_those_of_a_frame(self):
        scene, frame = relidar.torch.Scene.from_run(run()), relidar.torch.Frame(run(), log(), 2)
        poses = np.stack([relidar.pose(0.1 * i, 0, 0, 2 * i, 0, 0) for i in range(len(scene.instances))])
        out = relidar.torch.render(scene, frame, poses=poses, sensor=torch.eye(4))
        scene.renderer.place(poses, frame.view_origin)
        rays = frame.rays.numpy()
        expected = scene.renderer.forward(np.ascontiguousarray(rays[:, :3]), np.ascontiguousarray(rays[:, 3:6]))
        self.assert_same(out["depth"].detach().numpy(), expected["depth"])
        self.assertEqual(scene.instances["background"], 0)
        for name, index in scene.instances.items():
            self.assertEqual(run().scene.instances[index]["track"], "" if name == "background" else name)

    def test_no_rays(self):
        """A mask may select no ray. Gradients of such a batch are 0."""
        for training in False, True:
            case = TorchCase(training=training)
            none = case.tensor[case.tensor[:, 0] > 1e9].requires_grad_()
            out = case.render(rays=none)
            full = case.render()
            self.assertEqual(out.keys(), full.keys())
            for name, values in out.items():
                self.assertEqual((tuple(values.shape), values.dtype), ((0,), full[name].dtype), name)
            sum(out[name].sum() for name in UPSTREAM).backward()
            self.assertFalse(case.scene.means.grad.to_dense().any())
            self.assertEqual(none.grad.shape, (0, 6))

    def test_bad_input(self):
        case = TorchCase()
        render, scene, rays = relidar.torch.render, case.scene, case.tensor
        self.assert_fails(relidar.DataError, "rays: ... float64 [40, 6]", render, scene, rays.double())
        self.assert_fails(relidar.DataError, "rays: ... float32 [6, 40]", render, scene, rays.T)
        self.assert_fails(relidar.DataError, "origins: ... float32 [40, 6]", render, scene, (rays, rays))
        self.assert_fails(relidar.DataError, "a tuple of 3", render, scene, (rays[:, :3], rays[:, 3:], rays[:, :1]))
        self.assert_fails(relidar.DataError, "directions: ... float32 [3, 3]", render, scene, (rays[:, :3], rays[:3, 3:]))
        self.assert_fails(relidar.DataError, "poses: ... float64 [1, 4, 4]", render, scene, rays, poses=np.eye(4)[None])
        self.assert_fails(relidar.DataError, "sensor: ", render, scene, rays, sensor=torch.zeros(3))
        self.assert_fails(relidar.DataError, "sensor: ", render, scene, rays, sensor=2 * torch.eye(4))
        self.assert_fails(relidar.DataError, "NoneType", render, scene, None)
        for change in 3.0, 0.0, np.nan, np.inf:
            wrong = rays.clone()
            wrong[7, 3:6] *= change
            self.assert_fails(relidar.DataError, "rays: ray 7 ... length 1", render, scene, wrong)
        wrong = rays.clone()
        wrong[3, 0] = np.nan
        self.assert_fails(relidar.DataError, "rays: ray 3 ... finite", render, scene, wrong)
        opaque = torch.ones(32, requires_grad=True)
        render(scene, rays, opacities=opaque)["intensity"].sum().backward()
        self.assertTrue(torch.isfinite(opaque.grad).all())
        self.assert_fails(relidar.DataError, "rays: ... float32 [40, 6] ... meta", render, scene, rays.to("meta"))
        self.assert_fails(relidar.DataError, "scales: ... float32 [3, 2]", render, scene, rays, scales=torch.ones(3, 2))
        self.assert_fails(relidar.DataError, "2 sensors", render, scene, [rays], sensor=torch.zeros(2, 4, 4))
        self.assert_fails(relidar.UsageError, "colors", render, scene, rays, colors=rays)
        plain = relidar.torch.Scene(relidar.Scene(case.surfels))
        self.assert_fails(relidar.UsageError, "rays=True", render, plain, rays.clone().requires_grad_())
        self.assert_fails(relidar.UsageError, "poses=True", render, plain, rays, sensor=torch.eye(4, requires_grad=True))
        plain.means = torch.nn.Parameter(torch.ones(1, 3))
        self.assert_fails(relidar.DataError, "means: ... float32 [1, 3]", render, plain, rays)

    def test_dlpack_arguments(self):
        case = TorchCase()
        values, gradients = case.expected()
        case.renderer.upload({name: torch.from_numpy(array) for name, array in case.surfels.items()})
        case.renderer.place(torch.from_numpy(case.poses), case.tensor[:, :3].mean(0).double())
        rendered = case.renderer.forward(*(torch.from_numpy(array) for array in case.rays))
        actual = case.renderer.backward({name: torch.from_numpy(array) for name, array in case.upstream.items()})
        self.assert_same(rendered["depth"], values["depth"])
        self.assert_same(actual["sh"], gradients["sh"])
        pose, rays = run().trajectory[1][2], {name: array for name, array in run().rays().items() if name != "ring"}
        tensors = {name: torch.from_numpy(array) for name, array in rays.items()}
        self.assert_same(run().render(tensors, time=0, pose=torch.from_numpy(pose))["range"], run().render(rays, time=0, pose=pose)["range"])


if __name__ == "__main__":
    unittest.main()
