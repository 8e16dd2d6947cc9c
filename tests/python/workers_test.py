# SPDX-License-Identifier: Apache-2.0
"""Tests runs in worker processes: pickles, forked processes, spawned actors and ScanDataset."""
import multiprocessing
import os
import pickle
import shutil
import signal
import unittest
from unittest import mock

import numpy as np

import relidar
from common import FOLDER, TestCase, run
from relidar.scan_dataset import ScanDataset

try:
    import torch
except ModuleNotFoundError:
    torch = None


def sum_of_scan(loaded, time):
    return float(loaded.render(time=time)["range"].sum())


class Pickles(TestCase):
    def assert_same_run(self, actual, expected):
        for name, values in expected.surfels.items():
            self.assert_same(actual.surfels[name], values)
        self.assertEqual(actual.edits, expected.edits)
        self.assertEqual(actual.config.values(), expected.config.values())
        time = expected.times[3]
        for name, values in expected.render(time=time).items():
            if name not in ("run",):
                self.assert_same(actual.render(time=time)[name], values)

    def test_of_a_saved_run_holds_its_folder(self):
        changed = relidar.Run.load(run().folder, settings={"render.range": "median"})
        data = pickle.dumps(changed)
        self.assertLess(len(data), 100_000)
        self.assert_same_run(pickle.loads(data), changed)

    def test_of_an_edited_run_holds_its_content(self):
        track = next(iter(run().actors))
        edited = run().edit().remove(track).run()
        surfels = edited.surfels
        surfels["opacity_logit"] += np.float32(0.25)
        for changed in (edited, edited.with_surfels(surfels)):
            self.assert_same_run(pickle.loads(pickle.dumps(changed)), changed)
        saved = run().edit().remove(track).save(FOLDER / "edited_pickle")
        self.assertLess(len(pickle.dumps(saved)), 100_000)

    def test_of_a_folder_that_changed_holds_the_content_of_the_run(self):
        folder = FOLDER / "changing"
        shutil.copytree(run().folder, folder)
        loaded = relidar.Run.load(folder)
        data = pickle.dumps(loaded)
        run().edit().keep("background").save(folder, overwrite=True)
        self.assert_fails(relidar.DataError, f"{folder} ... changed", pickle.loads, data)
        self.assert_same_run(pickle.loads(pickle.dumps(loaded)), loaded)

    def test_arrives_in_a_spawned_process(self):
        time = run().times[3]
        with multiprocessing.get_context("spawn").Pool(1) as pool:
            self.assertEqual(pool.apply_async(sum_of_scan, (run(), time)).get(timeout=120), sum_of_scan(run(), time))


class Fork(TestCase):
    def exit_code_of_child(self, call):
        """Returns the exit code of a forked process that calls a function. Fails after a minute."""
        child = os.fork()
        if child == 0:
            signal.alarm(60)
            code = 1
            try:
                code = call()
            finally:
                os._exit(code)
        status = os.waitpid(child, 0)[1]
        self.assertFalse(os.WIFSIGNALED(status), "the child hangs")
        return os.waitstatus_to_exitcode(status)

    def test_the_device_of_the_parent_is_refused(self):
        time = run().times[3]
        expected = sum_of_scan(run(), time)

        def use():
            try:
                sum_of_scan(run(), time)
            except relidar.DeviceError as error:
                run.cache_clear()   # ends the renderer
                return 0 if "spawn" in str(error) else 2
            return 3

        self.assertEqual(self.exit_code_of_child(use), 0)
        self.assertEqual(sum_of_scan(run(), time), expected)


class Points(TestCase):
    def test_on_the_device_are_those_of_the_scan(self):
        time = run().times[4]
        scan = run().render("VLP-16:180x10", time=time, pose=run().trajectory, deskew=True)
        returned = (scan["drop_prob"] < 0.5) & (scan["median_range"] > 0)
        points = run().points("VLP-16:180x10", time=time, pose=run().trajectory)
        self.assertGreater(np.count_nonzero(returned), 100)
        for name, of_scan in (("position", "points"), ("time", "time"), ("ring", "ring"), ("instance", "instance")):
            np.testing.assert_array_equal(points[name].numpy(), scan[of_scan][returned], name)
        np.testing.assert_allclose(points["intensity"].numpy(), scan["intensity"][returned], atol=0.01)   # not rounded
        self.assert_same(points["pose"], scan["pose"])


class Spawn(TestCase):
    def test_a_spawned_actor_is_in_scans_that_name_it(self):
        loaded = pickle.loads(pickle.dumps(run()))
        track = next(iter(loaded.actors))
        time, pose = loaded.times[4], loaded.trajectory[1][4] @ relidar.pose(8, 1, 0)
        moved = loaded.render(time=time, actors={track: pose}, boxes=True)
        before = loaded.render(time=time)
        loaded.spawn(track, "copy")
        scan = loaded.render(time=time, actors={"copy": pose}, boxes=True)
        self.assert_same(scan["range"], moved["range"])
        self.assertEqual(list(scan["boxes"]["track"]), ["copy"])
        self.assert_same(scan["boxes"]["class"], moved["boxes"]["class"])
        self.assert_same(scan["boxes"]["points"], moved["boxes"]["points"])
        names = list(scan["instance_names"])
        self.assert_same(scan["instance"] == names.index("copy"), moved["instance"] == names.index(track))
        self.assert_same(loaded.render(time=time)["range"], before["range"])
        self.assert_fails(relidar.UsageError, "copy", loaded.spawn, track, "copy")
        self.assertRaises(TypeError, loaded.spawn, None, "nothing")
        loaded.despawn("copy")
        self.assert_fails(relidar.UsageError, "copy", loaded.render, time=time, actors={"copy": pose})
        alone = loaded.edit().keep("actors")
        for other in list(loaded.actors)[1:]:
            alone.remove(other)
        loaded.spawn(alone.run(), "asset")
        self.assert_same(loaded.render(time=time, actors={"asset": pose})["range"], moved["range"])


@unittest.skipIf(torch is None, "PyTorch is not installed")
class Dataset(TestCase):
    def setUp(self):
        self.track = next(iter(run().actors))
        self.data = ScanDataset(run(), "VLP-16:180x10", [(time, None) for time in run().times[2:5]],
                                [[], [("move", self.track, relidar.pose(0, 1, 0))]], sample=3)

    def test_points_are_in_the_box_of_their_instance(self):
        n_inside = 0
        for item in (self.data[i] for i in range(len(self.data))):
            self.assertEqual(item["points"].shape, (len(item["instance"]), 4))
            self.assertEqual(item["boxes"].shape, (len(item["classes"]), 7))
            for row, (x, y, z, length, width, height, yaw) in enumerate(item["boxes"].tolist()):
                points = item["points"][item["instance"] == row, :3].numpy() - np.array([x, y, z])
                c, s = np.cos(yaw), np.sin(yaw)
                local = points @ np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
                inside = np.all(np.abs(local) < 0.5 * np.array([length, width, height]) + 0.3, axis=1)
                self.assertGreater(inside.mean(), 0.9)
                n_inside += inside.sum()
            self.assertTrue((item["classes"] >= 0).all())
        self.assertGreater(n_inside, 20)

    def test_a_standing_object_has_the_points_in_its_box(self):
        scan = run().render(time=run().times[3], deskew=True, boxes=True)
        wall = np.flatnonzero(((scan["instance"] == 0) & (scan["points"][..., 2] > -1) & (scan["drop_prob"] < 0.5)).ravel())[0]
        centre = scan["pose"] @ np.append(scan["points"].reshape(-1, 3)[wall], 1)
        parked = {"track": "parked", "class": "Car", "is_static": 1, "size_m": [2.0, 2.0, 2.0], "pose": relidar.pose(*centre[:3], 30), "points": 9}
        scan["boxes"] = {name: np.concatenate([scan["boxes"][name], np.array([value])]) for name, value in parked.items()}
        item = ScanDataset(mock.Mock(times=run().times, categories={}, render=lambda *_, **__: scan), classes=["Car"])[3]
        last = len(item["boxes"]) - 1
        self.assertEqual(item["classes"][last], 0)
        distance = np.abs(item["points"][item["instance"] == last, :3].numpy() - item["boxes"][last, :3].numpy()).max(1)
        self.assertGreater(len(distance), 0)
        self.assertLess(distance.max(), 1.6)

    def test_items_are_scans_of_the_edited_run(self):
        moved = run().edit().move(self.track, relidar.pose(0, 1, 0)).run()
        scan = moved.render("VLP-16:180x10", time=run().times[3], sample=7, deskew=True)
        returned = (scan["drop_prob"] < 0.5) & (scan["median_range"] > 0)
        self.assert_same(self.data[4]["points"][:, :3].numpy(), scan["points"][returned])
        with self.assertRaises(IndexError):
            self.data[len(self.data)]
        self.assert_fails(relidar.UsageError, "poses", ScanDataset, run(), poses=run().trajectory)
        self.assert_fails(relidar.UsageError, "remove", ScanDataset, run(), edits=[("remove", self.track)])
        self.assertEqual(len(list(ScanDataset(run()).loader(batch_size=None))), len(run().times))

    def test_workers_return_the_same(self):
        batches = list(self.data.loader(batch_size=2, num_workers=2))
        items = [{name: values[k] for name, values in batch.items()} for batch in batches for k in range(len(batch["time"]))]
        self.assertEqual(len(items), len(self.data))
        for i, item in enumerate(items):
            for name, values in self.data[i].items():
                self.assertTrue(torch.equal(item[name], values), name)


if __name__ == "__main__":
    unittest.main()
