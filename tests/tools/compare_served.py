#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares a scan of a running `relidar serve` with an npz file that `relidar render --trajectory
--deskew` wrote for the same poses. Images and points must be equal bit by bit, with and without an
image in the request.

  compare_served.py SOURCE_ROOT HOST:PORT WAY.csv TIME_S SCAN.npz SENSOR [CERT.pem]

Boxes must equal those that `--boxes` writes to scans.json in the folder of SCAN.npz.
The poses of WAY.csv have no rotation. Prints errors and exits with code 1 if a check fails.
"""
import csv
import json
import pathlib
import sys

import numpy as np

root, address, way, time_s, npz, sensor = sys.argv[1:7]
sys.path.insert(0, f"{root}/tools/examples")
from checks import check, finish, render_service   # noqa: E402

v1, service = render_service(address, *sys.argv[7:])
poses = [[float(x) for x in row] for row in list(csv.reader(open(way)))[1:]]
path = [v1.TimedPose(time_s=t, pose=v1.Pose(translation=v1.Vector(x=x, y=y, z=z))) for t, x, y, z, _ in poses]
request = v1.RenderLidarRequest(path=path, time_s=float(time_s), points_at_s=float(time_s),
                                wanted=v1.Wanted(points=True, range_image=True, drop_probability=True, boxes=True))
if sensor:
    request.sensor.name = sensor
scan = service.RenderLidar(request, timeout=60)
request.wanted.CopyFrom(v1.Wanted(points=True))
alone = service.RenderLidar(request, timeout=60)   # without an image, the points are computed on the device
truth = np.load(npz)

shape = (scan.image.rows, scan.image.columns)
for name, data in (("range", scan.image.range_m), ("intensity", scan.image.intensity), ("drop_prob", scan.image.drop_probability)):
    served = np.frombuffer(data, "<f4").reshape(shape)
    check(f"{name}: shape {served.shape}, expected {truth[name].shape}", served.shape == truth[name].shape)
    check(f"{name}: {(served != truth[name]).sum()} of {served.size} values differ", np.array_equal(served, truth[name]))

ranges = np.where(truth["median_range"] > 0, truth["median_range"], truth["range"])
hit = (truth["drop_prob"] < 0.5) & (ranges > 0)
for what, points in (("points beside an image", scan.points), ("points alone", alone.points)):
    for name, data, kind, expected in (("position", points.xyz_m, "<f4", truth["points"]), ("intensity", points.intensity, "<f4", truth["intensity"]),
                                       ("ring", points.ring, "<u2", truth["ring"]), ("time", points.time_s, "<f4", truth["time"]),
                                       ("instance", points.instance, "<i4", truth["instance"])):
        served, expected = np.frombuffer(data, kind), expected[hit].ravel()
        check(f"{what}: {len(served)} numbers of {name}, expected {len(expected)}, more than 10", len(served) == len(expected) > 10)
        check(f"{what}: {name} differs", np.array_equal(served, expected))

boxes = json.loads(pathlib.Path(npz).with_name("scans.json").read_text())["scans"][0]["boxes"]
check(f"{len(scan.boxes)} boxes, expected {len(boxes)}, at least 1", len(scan.boxes) == len(boxes) > 0)
for served, expected in zip(scan.boxes, boxes):
    pose, what = served.dataset_from_box.translation, f"box {expected['track']}"
    check(f"{what}: {served.name} of class {served.category}", (served.name, served.category) == (expected["track"], expected["class"]))
    check(f"{what}: {served.points} points, share {served.visible_share}",
          (served.points, served.visible_share) == (expected["points"], expected["visible_share"]))
    check(f"{what}: another time or pose", np.allclose([served.time_s, pose.x, pose.y, pose.z],
                                                       [expected["time_s"], *(row[3] for row in expected["world_from_box"][:3])], atol=1e-6))

finish()
