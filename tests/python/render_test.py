# SPDX-License-Identifier: Apache-2.0
"""Tests scans of a run. They must equal the scans that the command line tool writes. Also tests
poses, actors and sensors of the caller, and the lifetime of arrays."""
import gc
import json
import struct
import unittest
import zlib

import numpy as np

import relidar
from common import FOLDER, TestCase, log, run, tool


def present(loaded, time):
    """Returns the tracks of the actors that are present at a time."""
    return {name: track for name, track in loaded.actors.items() if track[0][0] <= time <= track[0][-1]}


def read_png(path):
    """Decodes a PNG file of 8-bit colours or 16-bit gray values."""
    data, position, packed = path.read_bytes(), 8, b""
    while position < len(data):
        size, kind = struct.unpack(">I4s", data[position:position + 8])
        chunk = data[position + 8:position + 8 + size]
        if kind == b"IHDR":
            columns, rows, bits, colours = struct.unpack(">IIBB", chunk[:10])
        packed += chunk if kind == b"IDAT" else b""
        position += size + 12
    channels = {0: 1, 2: 3}[colours]
    step = channels * bits // 8
    lines = np.frombuffer(zlib.decompress(packed), np.uint8).reshape(rows, 1 + columns * step)
    pixels = np.zeros((rows + 1, columns + 1, step), int)   # a border of zeros above and to the left
    for row, line in enumerate(lines):
        values = line[1:].reshape(columns, step)
        for column in range(columns):
            a, b, c = pixels[row + 1, column], pixels[row, column + 1], pixels[row, column]
            p = a + b - c
            paeth = np.where((abs(p - a) <= abs(p - b)) & (abs(p - a) <= abs(p - c)), a,
                             np.where(abs(p - b) <= abs(p - c), b, c))
            predicted = (0 * a, a, b, (a + b) // 2, paeth)[line[0]]
            pixels[row + 1, column + 1] = (values[column] + predicted) % 256
    image = pixels[1:, 1:].astype(np.uint8)
    return image if bits == 8 else np.ascontiguousarray(image).view(">u2")[..., 0].astype(np.uint16)


class Render(TestCase):
    def test_is_what_the_tool_writes(self):
        position = run().held_out[0]
        number, time = run().frame_numbers[position], run().times[position]
        tool("render", run().folder, "--out", FOLDER / "scans", "--frames", f"{number}:{number + 1}")
        scan = run().render(time=time)
        with np.load(FOLDER / "scans" / f"frame_{number:06}.npz") as written:
            self.assertEqual(list(scan), list(written))
            for name in written:
                if written[name].dtype.kind != "f":
                    self.assert_same(scan[name], written[name])
                    continue
                self.assertEqual((scan[name].dtype, scan[name].shape), (written[name].dtype, written[name].shape))
                # The tool adds the offset of the world, the module uses the dataset's
                # world frame. Positions therefore differ by 1e-9 m before they are
                # rounded to float.
                np.testing.assert_allclose(scan[name], written[name], rtol=1e-4, atol=1e-4, err_msg=name)

    def test_cameras_are_those_of_the_tool(self):
        """The tool writes PNG files, which this test decodes with zlib."""
        camera = {"K": [[40, 0, 31.5], [0, 40, 15.5], [0, 0, 1]], "size": [64, 32], "yaw_pitch_roll_deg": [40, 5, 0]}
        (FOLDER / "camera.json").write_text(json.dumps(camera))
        number, time = run().frame_numbers[3], run().times[3]
        tool("render", run().folder, "--out", FOLDER / "camera", "--frames", f"{number}:{number + 1}",
             "--camera", FOLDER / "camera.json")
        scan = run().render(time=time, camera=camera)
        gray = read_png(FOLDER / "camera" / f"frame_{number:06}.png")
        depth = read_png(FOLDER / "camera" / f"frame_{number:06}_depth.png")
        self.assertEqual((gray.shape, depth.shape, depth.dtype), ((32, 64, 3), (32, 64), np.uint16))
        np.testing.assert_allclose(gray[..., 0], scan["picture"], atol=1)
        z = scan["points"][..., 2].astype(float) * (scan["drop_prob"] < 0.5)
        # Both round; the poses of tool and module differ by 1e-9 m.
        near = np.abs(depth - 256 * z) < 1
        self.assertGreater(np.mean(near), 0.999)
        self.assertGreater(np.mean(depth > 0), 0.2)
        np.testing.assert_array_equal(scan["K"], camera["K"])
        left = run().render(time=time, pose=run().trajectory[1][3] @ relidar.pose(0, 1, 0), camera=dict(camera, K=scan["K"]))
        np.testing.assert_allclose(left["pose"][:3, 3] - scan["pose"][:3, 3], run().trajectory[1][3][:3, 1], atol=1e-6)
        self.assert_fails(relidar.UsageError, "sensor and a camera", lambda: run().render("VLP-16", camera="kitti"))
        self.assert_fails(relidar.UsageError, "random seed", lambda: run().render(camera=camera, sample=1))
        self.assert_fails(relidar.UsageError, "'kiti' ... kitti", lambda: run().render(camera="kiti"))
        self.assert_fails(relidar.DataError, "camera: size ... 1 number", lambda: run().render(camera=dict(camera, size=[1])))

    def test_boxes_count_the_points_of_their_actors(self):
        """Counts the points in each box. Also compares the boxes with those of the tool."""
        time, number = run().times[3], run().frame_numbers[3]
        scan = run().render(time=time, frame="world", boxes=True)
        boxes = scan["boxes"]
        self.assertGreater(boxes["points"].max(), 20)
        returned = (scan["drop_prob"] < 0.5) & (scan["median_range"] > 0)
        instance = scan["instance"][returned]
        for track, n_points in zip(boxes["track"], boxes["points"]):
            self.assertEqual(n_points, np.count_nonzero(instance == list(scan["instance_names"]).index(track)))
        tool("render", run().folder, "--out", FOLDER / "boxes", "--frames", f"{number}:{number + 1}", "--boxes")
        written = json.loads((FOLDER / "boxes/scans.json").read_text())["scans"][0]["boxes"]
        self.assertEqual(list(boxes["track"]), [box["track"] for box in written])
        for name in ("size_m", "time_s", "velocity_mps", "points", "visible_share"):
            np.testing.assert_allclose(boxes[name], [box[name] for box in written], rtol=1e-4, atol=1e-3, err_msg=name)
        np.testing.assert_allclose(boxes["pose"], [box["world_from_box"] for box in written], atol=1e-4)
        moved = run().render(time=time, actors={boxes["track"][0]: boxes["pose"][0]}, boxes=True)["boxes"]
        self.assertEqual(list(moved["track"]), [boxes["track"][0]])
        np.testing.assert_allclose(moved["pose"], boxes["pose"][:1], atol=1e-6)
        self.assertNotIn("boxes", run().render(time=time))

    def test_trajectory_and_actors_of_the_log_are_the_default(self):
        time = run().times[3]
        default = run().render(time=time)
        self.assert_same(run().render(time=time, pose=run().trajectory)["range"], default["range"])
        # The tracks of the boxes give the same poses of actors as the run. present()
        # leaves out actors that are absent at this time.
        given = run().render(time=time, actors=present(run(), time))
        self.assertGreater(np.mean(given["instance"] == default["instance"]), 0.99)
        self.assertTrue(np.any(given["instance"] > 0))

    def test_follows_the_sweeps_of_the_log(self):
        """The log's sensor must follow the azimuths of its head in each sweep, as in the command
        line tool. The test turns each firing by a fixed angle."""
        folder = FOLDER / "turned"
        relidar.Run.load(run().folder).save(folder)
        _, columns = run().rays()["time"].shape
        shift = (0.02 * np.sin(np.arange(columns) / 40)).astype("<f4")
        head = json.dumps({"__metadata__": {"format": "relidar sweeps", "version": "1", "relidar": "0"},
                           "000003": {"dtype": "F32", "shape": [columns], "data_offsets": [0, shift.nbytes]}}).encode()
        (folder / "sweeps.safetensors").write_bytes(len(head).to_bytes(8, "little") + head + shift.tobytes())
        turned, time, number = relidar.Run.load(folder), run().times[3], run().frame_numbers[3]
        scan, nominal = turned.render(time=time), run().render(time=time)
        azimuth = [np.arctan2(s["directions"][..., 1], s["directions"][..., 0]) for s in (scan, nominal)]
        difference = np.angle(np.exp(1j * (azimuth[0] - azimuth[1])))
        np.testing.assert_allclose(np.sort(difference[0]), np.sort(shift), atol=1e-5)
        tool("render", folder, "--out", FOLDER / "turned_scans", "--frames", f"{number}:{number + 1}")
        with np.load(FOLDER / "turned_scans" / f"frame_{number:06}.npz") as written:
            np.testing.assert_allclose(scan["directions"], written["directions"], atol=1e-6)
            np.testing.assert_allclose(scan["range"], written["range"], rtol=1e-4, atol=1e-4)
        self.assert_same(turned.render(time=time, actors=present(turned, time))["directions"], scan["directions"])
        deskewed = turned.render(time=time, deskew=True)
        returned = (deskewed["drop_prob"] < 0.5) & (deskewed["median_range"] > 0)
        np.testing.assert_allclose(turned.points(time=time)["position"].numpy(), deskewed["points"][returned], atol=1e-4)
        driven = turned.render(time=time, pose=turned.trajectory)
        # a path of the caller has no recorded sweeps
        self.assert_same(driven["directions"], nominal["directions"])

    def test_times_outside_are_refused(self):
        render, times = run().render, run().times
        self.assert_fails(relidar.UsageError, "1000 s", render, time=1000.0)
        self.assert_fails(relidar.UsageError, "-0.2 s", render, time=times[0] - 0.2)
        poses = np.stack([np.eye(4)] * 2)
        self.assert_fails(relidar.UsageError, "poses ... 2.5 s ... 1 ... 2 s", render, time=2.5,
                          pose=(np.array([1.0, 2.0]), poses))
        name = next(iter(run().actors))
        self.assert_fails(relidar.UsageError, f'actors["{name}"]', render, time=times[3],
                          actors={name: (np.array([times[3] + 5.0, times[3] + 6.0]), poses)})
        render(time=1000.0, pose=np.eye(4))   # the sensor is static, so any time is allowed

    def test_pose_moves_the_sensor(self):
        time = run().times[3]
        times, poses = run().trajectory
        up = poses[3] @ relidar.pose(0, 0, 1.0)
        low, high = run().render(time=time, pose=poses[3]), run().render(time=time, pose=up)
        np.testing.assert_allclose(high["pose"], up, atol=1e-9)

        def height(scan):
            """Returns the height of the road below the sensor, from rays that point down and ahead."""
            returned = (scan["drop_prob"] < 0.5) & (scan["directions"][..., 2] < -0.25) & (scan["instance"] == 0)
            return -np.median((scan["median_range"] * scan["directions"][..., 2])[returned])

        self.assertAlmostEqual(height(high) - height(low), 1.0, delta=0.05)

    def test_actors_that_are_not_named_are_absent(self):
        time = run().times[3]
        self.assertTrue(np.any(run().render(time=time)["instance"] > 0))
        empty, background = run().render(time=time, actors={}), run().render(time=time, only=["background"])
        self.assertLessEqual(empty["instance"].max(), 0)
        self.assert_same(empty["range"], background["range"])

    def test_actor_where_the_caller_has_it(self):
        time = run().times[3]
        times, poses = run().trajectory
        ahead = poses[3] @ relidar.pose(8.0, 0, 0)   # a car in front of the sensor
        name = next(iter(run().actors))
        scan = run().render(time=time, actors={name: ahead})
        met = (scan["instance"] > 0) & (scan["median_range"] > 0)
        points = scan["points"][met]
        self.assertGreater(len(points), 10)
        self.assertLess(np.abs(np.median(points, axis=0) - [8.0, 0.0, 0.0])[:2].max(), 3.0)

    def test_rays_of_ones_own(self):
        time = run().times[3]
        own, native = run().render(run().rays(), time=time), run().render(time=time)
        self.assert_same(own["range"], native["range"])
        part = {name: np.ascontiguousarray(array[4:8, 100:140]) for name, array in run().rays().items()}
        self.assert_same(run().render(part, time=time)["range"], native["range"][4:8, 100:140])
        real = log().scan(3)
        self.assertEqual(run().render(real, time=time)["range"].shape, real["range"].shape)

    def test_known_sensors(self):
        self.assertIn("VLP-16", relidar.sensors())
        rays = relidar.rays("VLP-16")
        self.assertEqual(rays["directions"].shape[0], 16)
        np.testing.assert_allclose(np.linalg.norm(rays["directions"], axis=-1), 1.0, atol=1e-6)
        elevation = np.degrees(np.arcsin(rays["directions"][:, 0, 2]))
        # elevations from the manufacturer's manual
        np.testing.assert_allclose(elevation, np.arange(15, -16, -2), atol=1e-4)
        self.assertEqual(run().render("VLP-16", time=run().times[0])["range"].shape, rays["time"].shape)

    def test_sample_is_a_draw(self):
        time = run().times[3]
        a, b, c = (run().render(time=time, sample=seed) for seed in (1, 1, 2))
        self.assert_same(a["drop_prob"], b["drop_prob"])
        self.assertEqual(set(np.unique(a["drop_prob"])), {0.0, 1.0})
        self.assertFalse(np.array_equal(a["drop_prob"], c["drop_prob"]))

    def test_weather(self):
        for word in ("fog=", "rain=", "snow=", "wet=", "bloom", "sun="):
            self.assertIn(word, relidar.Run.render.__doc__)
        time = run().times[3]
        clear, fog = (run().render(time=time, sample=1, weather=weather) for weather in ("", "fog=60"))
        self.assertNotIn("source", clear)
        self.assertEqual(set(np.unique(fog["source"])) - {-1}, {0, 1})
        self.assert_same(fog["source"] == -1, fog["drop_prob"] == 1.0)
        in_air = fog["source"] == 1
        self.assertTrue((fog["instance"][in_air] == -1).all())
        self.assert_same(run().render(time=time, sample=1, weather="clear")["range"], clear["range"])
        sunny = run().render(time=time, sample=1, weather="sun=0:5,bloom")
        self.assertIn(5, np.unique(sunny["source"]))
        self.assertRaisesRegex(relidar.UsageError, "weather.*snow=-1.*100", run().render, time=time, weather="snow=-1")

    def test_world_frame(self):
        time = run().times[3]
        sensor, world = run().render(time=time, deskew=True), run().render(time=time, frame="world")
        turned = sensor["directions"] @ sensor["pose"][:3, :3].T
        np.testing.assert_allclose(world["directions"], turned, atol=1e-5)

    def test_arrays_outlive_the_run(self):
        folder = run().folder
        other = relidar.Run.load(folder)
        scan, scene = other.render(time=other.times[0]), other.scene
        ranges, mean = scan["range"].copy(), scene.surfels["mean"]
        self.assertTrue(np.shares_memory(mean, scene.surfels["mean"]))   # a view, not a copy
        self.assertFalse(mean.flags.writeable)
        copy = mean.copy()
        del other, scene
        gc.collect()
        self.assert_same(scan["range"], ranges)
        self.assert_same(mean, copy)
        scan["range"][...] = 0   # the array belongs to the caller

    def test_bad_input(self):
        time = run().times[0]
        render = run().render
        single = np.eye(4, dtype=np.float32)
        expected = "pose: found float32 [4,4] ... float64 [4,4]"
        self.assert_fails(relidar.DataError, expected, render, time=time, pose=single)
        self.assert_fails(relidar.DataError, "pose ... float64 [3,4]", render, time=time, pose=np.eye(4)[:3])
        self.assert_fails(relidar.DataError, "list ... float64 [4,4]", render, time=time, pose=np.eye(4).tolist())
        self.assert_fails(relidar.DataError, "C order", render, time=time, pose=np.asfortranarray(relidar.pose(1, 2, 3)))
        self.assert_fails(relidar.DataError, "rigid", render, time=time, pose=2 * np.eye(4))
        self.assert_fails(relidar.DataError, "mirrored", render, time=time, pose=np.diag([1.0, 1.0, -1.0, 1.0]))
        self.assert_fails(relidar.DataError, "finite", render, time=time, pose=np.full((4, 4), np.nan))
        self.assert_fails(relidar.DataError, "2 times ... 1", render, time=time, pose=(np.zeros(2), np.eye(4)[None]))
        self.assert_fails(relidar.DataError, "time 0 s", render, time=time, pose=(np.zeros(2), np.stack([np.eye(4)] * 2)))
        self.assert_fails(relidar.DataError, "time_s ... nan", render, time=float("nan"))
        self.assert_fails(relidar.UsageError, "nobody", render, time=time, actors={"nobody": np.eye(4)})
        self.assert_fails(relidar.UsageError, '"background"', render, time=time, only=["backgrund"])
        self.assert_fails(relidar.UsageError, "VLP-16", render, "VLP16", time=time)
        self.assert_fails(relidar.UsageError, 'lidar ... "rear"', render, time=time, lidar="rear")
        self.assert_fails(relidar.UsageError, "world", render, time=time, frame="map")
        directions = run().rays()["directions"]
        self.assert_fails(relidar.DataError, '"directions"', render, {}, time=time)
        self.assert_fails(relidar.DataError, "float64", render, {"directions": directions.astype(np.float64)}, time=time)
        self.assert_fails(relidar.DataError, "C order", render, {"directions": directions[:, ::2]}, time=time)
        self.assert_fails(relidar.DataError, "length", render, {"directions": 2 * directions}, time=time)
        three_times = {"directions": directions, "time": np.zeros(3, np.float32)}
        self.assert_fails(relidar.DataError, "time ... float32 [3]", render, three_times, time=time)


if __name__ == "__main__":
    unittest.main()
