# SPDX-License-Identifier: Apache-2.0
"""Tests logs, runs, settings and edits as files and as objects, and the error messages for invalid
files and objects."""
import json
import pathlib
import shutil
import unittest

import numpy as np

import relidar
from common import FOLDER, TestCase, log, run, street


class Poses(TestCase):
    def test_pose_is_rz_ry_rx(self):
        yaw, pitch, roll = np.radians([30.0, -20.0, 10.0])
        rz = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
        ry = np.array([[np.cos(pitch), 0, np.sin(pitch)], [0, 1, 0], [-np.sin(pitch), 0, np.cos(pitch)]])
        rx = np.array([[1, 0, 0], [0, np.cos(roll), -np.sin(roll)], [0, np.sin(roll), np.cos(roll)]])
        pose = relidar.pose(1, 2, 3, 30, -20, 10)
        np.testing.assert_allclose(pose[:3, :3], rz @ ry @ rx, atol=1e-12)
        np.testing.assert_array_equal(pose[:, 3], [1, 2, 3, 1])


class Logs(TestCase):
    def test_scan(self):
        scan = log().scan(2)
        self.assertEqual(list(scan), ["directions", "origin", "time", "ring", "range", "intensity", "class"])
        self.assertEqual([array.dtype.name for array in scan.values()], ["float32"] * 3 + ["uint16"] + ["float32"] * 2 + ["int32"])
        self.assertEqual(scan["range"].shape, (16, 256))
        self.assertTrue(np.all(scan["intensity"][scan["range"] == 0] == 0))
        self.assertEqual(len(log()), 8)
        times, poses = log().trajectory
        self.assert_same(times, log().times)
        # the vehicle drives at 8 m/s with 10 frames per second
        np.testing.assert_allclose(np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1), 0.8, rtol=0.05)
        self.assertGreaterEqual(set(log().boxes), set(run().actors))
        self.assertEqual(log().frame_lidars, [""] * 8)
        np.testing.assert_array_equal(log().mountings[""], np.eye(4))

    def test_settings_choose_frames(self):
        part = relidar.load_log(street(), relidar.Config("quick", {"dataset.frames_begin": 2, "dataset.frames_end": 5}))
        np.testing.assert_array_equal(part.frame_numbers, [2, 3, 4])

    def test_bad_input(self):
        self.assert_fails(relidar.DataError, "nowhere", relidar.load_log, "nowhere")
        self.assert_fails(relidar.UsageError, "'kity'", relidar.load_log, "kity:street")
        for position in (8, -1):
            with self.assertRaises(IndexError):
                log().scan(position)

    def test_wrong_integers(self):
        """Names the argument and the accepted numbers, instead of printing all signatures."""
        for sample in (-1, np.int64(-1), 2**64):
            self.assert_fails(relidar.UsageError, f"sample ... {sample}", run().render, sample=sample)
        self.assert_fails(TypeError, "sample ... 1.5", run().render, sample=1.5)
        self.assert_fails(relidar.UsageError, f"position ... {2**40}", log().scan, 2**40)
        for name in ("seed", "n_frames", "rows", "columns"):
            self.assert_fails(relidar.UsageError, f"{name} ... {2**70}", relidar.save_street, FOLDER / "none", **{name: 2**70})
        self.assert_fails(relidar.UsageError, "seed ... -1", relidar.save_street, FOLDER / "none", seed=-1)
        self.assert_fails(relidar.UsageError, "memory_limit_bytes ... -1", relidar.Device, memory_limit_bytes=-1)
        model = {"name": "background", "first": -1, "count": 1}
        self.assert_fails(relidar.UsageError, "first ... -1", relidar.Scene, run().surfels, models=[model])
        self.assert_same(run().render(sample=np.uint64(3))["range"], run().render(sample=3)["range"])


class Settings(TestCase):
    def test_values(self):
        given = {"train.iterations": 7, "sensor.rolling_shutter": False, "loss.depth": 0.25, "dataset.poses": pathlib.Path("p.txt")}
        settings = relidar.Config("quick", given)
        self.assertEqual([settings[key] for key in given], ["7", "false", "0.25", "p.txt"])
        (FOLDER / "settings.toml").write_text(settings.to_toml())
        self.assertEqual(relidar.Config.load(FOLDER / "settings.toml").values(), settings.values())
        self.assertTrue(settings.help("loss.depth"))
        other = settings.copy()
        other["loss.depth"] = 1
        self.assertEqual(settings["loss.depth"], "0.25")

    def test_bad_input(self):
        self.assert_fails(relidar.UsageError, "loss.dpth ... loss.depth", relidar.Config, "quick", {"loss.dpth": 1})
        self.assert_fails(relidar.UsageError, "loss.depth ... \"abc\" ... number", relidar.Config, "quick", {"loss.depth": "abc"})
        self.assert_fails(relidar.UsageError, "list", relidar.Config, "quick", {"loss.depth": [1]})
        self.assert_fails(relidar.UsageError, "'quick'", relidar.Config, "quik")
        self.assert_fails(relidar.DataError, "missing.toml", relidar.Config.load, "missing.toml")


class Runs(TestCase):
    def test_round_trip(self):
        run().save(FOLDER / "again")
        again = relidar.Run.load(FOLDER / "again")
        for name, array in run().surfels.items():
            self.assert_same(again.surfels[name], array)
        self.assertEqual(again.held_out, run().held_out)
        self.assert_fails(relidar.UsageError, "/again: ", run().save, FOLDER / "again")
        run().save(FOLDER / "again", overwrite=True)
        run().save(FOLDER / "run", overwrite=True)   # saves the run into its current folder

    def test_with_surfels(self):
        surfels = run().surfels
        surfels["mean"] += np.float32([0, 0, 5])
        raised = run().with_surfels(surfels)
        np.testing.assert_allclose(raised.surfels["mean"][:, 2] - run().surfels["mean"][:, 2], 5, atol=1e-5)
        self.assert_fails(relidar.DataError, "expected", run().with_surfels, {name: array[:-1] for name, array in surfels.items()})
        self.assert_fails(relidar.UsageError, '"mean"', run().with_surfels, dict(surfels, maen=surfels["mean"]))
        self.assert_fails(relidar.DataError, '"sh" ... missing', run().with_surfels, {k: v for k, v in surfels.items() if k != "sh"})
        doubles = dict(surfels, mean=surfels["mean"].astype(float))
        self.assert_fails(relidar.DataError, "mean ... float64", run().with_surfels, doubles)
        self.assert_fails(relidar.DataError, "C order", run().with_surfels, dict(surfels, mean=np.asfortranarray(surfels["mean"])))

    def test_settings_of_a_run(self):
        median = relidar.Run.load(run().folder, settings={"render.range": "median"})
        scan = median.render(time=median.times[0])
        met = scan["median_range"] > 0
        self.assert_same(scan["range"][met], scan["median_range"][met])
        wrong = {"render.rnge": "median"}
        self.assert_fails(relidar.UsageError, "render.rnge ... render.range", relidar.Run.load, run().folder, settings=wrong)

    def test_bad_files(self):
        self.assert_fails(relidar.DataError, "nowhere", relidar.Run.load, "nowhere")
        newer = FOLDER / "newer"
        shutil.copytree(run().folder, newer)
        scene = json.loads((newer / "scene.json").read_text())
        (newer / "scene.json").write_text(json.dumps(dict(scene, version=scene["version"] + 1)))
        self.assert_fails(relidar.DataError, str(scene["version"] + 1), relidar.Run.load, newer)
        cut = FOLDER / "cut"
        shutil.copytree(run().folder, cut)
        (cut / "model.safetensors").write_bytes((cut / "model.safetensors").read_bytes()[:1000])
        self.assert_fails(relidar.DataError, "model.safetensors", relidar.Run.load, cut)

    def test_errors_are_also_built_in_ones(self):
        errors = {relidar.UsageError: (ValueError, 2), relidar.DataError: (ValueError, 3), relidar.DeviceError: (RuntimeError, 4)}
        for error, (built_in, code) in errors.items():
            self.assertEqual((error.__bases__, error.code), ((relidar.Error, built_in), code))
        self.assert_fails(relidar.DeviceError, "99", relidar.Device, 99)
        self.assert_fails(relidar.UsageError, "\"fast\" ... auto, ray_query", relidar.Device, traversal="fast")


class Edits(TestCase):
    def test_chain(self):
        tracks = list(run().actors)
        start = run().trajectory[1][0] @ relidar.pose(10, 3, 0)
        edited = run().edit().remove(tracks[0]).copy(tracks[1], start, speed_mps=2.0).retime(tracks[1], 0.1).save(FOLDER / "edited")
        self.assertEqual(list(edited.actors), [tracks[1], tracks[1] + "-copy-1"])
        times, poses = edited.actors[tracks[1] + "-copy-1"]
        np.testing.assert_allclose(poses[0], start, atol=1e-6)
        way = (poses[-1] - poses[0])[:3, 3]
        np.testing.assert_allclose(way / (times[-1] - times[0]), 2.0 * start[:3, 0], atol=1e-6)   # straight ahead at 2 m/s
        self.assertEqual(len(relidar.Run.load(FOLDER / "edited").edits), 3)
        self.assertEqual(list(run().actors), tracks)   # the original run must not change

    def test_move_and_follow(self):
        track = list(run().actors)[0]
        times, poses = run().actors[track]
        moved = run().edit().move(track, relidar.pose(1, 2, 0, 90)).run()
        np.testing.assert_allclose(moved.actors[track][1], poses @ relidar.pose(1, 2, 0, 90), atol=1e-6)
        there = relidar.pose(1, 2, 0, 90)
        back = run().edit().move(track, there).move(track, np.linalg.inv(there)).retime(track, 0.0).run()
        self.assert_same(back.actors[track][1], poses)
        self.assert_same(back.surfels["mean"], run().surfels["mean"])
        self.assert_fails(relidar.DataError, "nan ... finite", run().edit().retime, track, float("nan"))
        way = (np.array([0.0, 1.0]), np.stack([relidar.pose(0, 0, 0), relidar.pose(5, 0, 0)]))
        followed = run().edit().follow(track, way).run().actors[track]
        np.testing.assert_allclose(followed[1][-1], way[1][1], atol=1e-9)

    def test_a_refused_edit_changes_nothing(self):
        edit = run().edit()
        self.assert_fails(relidar.UsageError, "nobody", edit.remove, "nobody")
        self.assert_fails(relidar.UsageError, "\"everything\" ... background ... actors", edit.keep, "everything")
        self.assertEqual(edit.run().edits, [])


if __name__ == "__main__":
    unittest.main()
