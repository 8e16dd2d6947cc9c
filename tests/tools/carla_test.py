#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs tools/examples/carla_lidar.py with a stub of CARLA and a server of a street with assets.
Checks its output in CARLA's left-handed frames. Cars must be where the stub has them, and not
mirrored. Without cars, a scan must equal the scan of relidar's service from a pose that this test
computes by hand.

  carla_test.py SOURCE_ROOT HOST:PORT WORK

Prints errors and exits with code 1 if a check fails.
"""
import pathlib
import subprocess
import sys

import numpy as np

root, address, work = pathlib.Path(sys.argv[1]), sys.argv[2], pathlib.Path(sys.argv[3])
sys.path[:0] = [str(root / "tests/tools/carla_stub"), str(root / "tools/examples")]
import carla   # noqa: E402  the stub
from checks import check, finish, render_service   # noqa: E402

MAP = (2.0, -0.5, 0.0, -4.0)   # pose of CARLA's origin in the dataset's world: right-handed, yaw to the left
MOUNT = (0.8, 0.2, 1.73, 6.0)   # pose of the sensor on the ego vehicle, also right-handed
text = lambda values: ",".join(map(str, values))
run = subprocess.run([sys.executable, "-B", root / "tools/examples/carla_lidar.py", address, "--out", work, "--scans", "5",
                      "--sensor", "Pandar128", f"--mount={text(MOUNT)}", f"--dataset-from-carla={text(MAP)}"],
                     env={"PYTHONPATH": str(root / "tests/tools/carla_stub"), "PATH": "/usr/bin:/bin"}, capture_output=True, text=True)
check(f"carla_lidar.py: {run.stdout}{run.stderr}", run.returncode == 0)
frames = sorted(int(file.stem) for file in work.glob("*.bin"))
check(f"scans at frames {frames}, expected one each two ticks of 50 ms", frames == [2, 4, 6, 8, 10])


def left_handed(transform):
    return np.array(transform.get_matrix())


mount = left_handed(carla.Transform(carla.Location(MOUNT[0], -MOUNT[1], MOUNT[2]), carla.Rotation(yaw=-MOUNT[3])))


def inside(frame, points, mirrored=False):
    """Counts the points in each car's box, without the lowest 0.3 m, which contain road. CARLA's
    world is left-handed. A car has some thousand points. Because the street is hardly trained, some
    hundred points lie in the air."""
    counts = {}
    for id in (carla.CAR, carla.PASSING):
        at = frame * carla.TICK_S
        # if the car is absent, uses its later position
        car = carla.transform_of(id, at) or carla.transform_of(id, 0.3)
        if mirrored:
            car = carla.Transform(carla.Location(car.location.x, -car.location.y, 0.0), carla.Rotation(yaw=-car.rotation.yaw))
        box = carla.Actor(id).bounding_box
        world = left_handed(carla.transform_of(carla.EGO, at)) @ mount @ np.column_stack([points[:, :3], np.ones(len(points))]).T
        local = (np.linalg.inv(left_handed(car)) @ world)[:3].T - [box.location.x, box.location.y, box.location.z]
        extent = np.array([box.extent.x, box.extent.y, box.extent.z]) + 0.3
        counts[id] = int((np.all(abs(local) < extent, axis=1) & (local[:, 2] > 0.3 - box.extent.z)).sum())
    return counts


clouds = {frame: np.fromfile(work / f"{frame:06d}.bin", "<f4").reshape(-1, 4) for frame in frames}
for frame, points in clouds.items():
    there = {id for id in (carla.CAR, carla.PASSING) if carla.transform_of(id, frame * carla.TICK_S)}
    counts, wrong = inside(frame, points), inside(frame, points, mirrored=True)
    for id, n in counts.items():
        check(f"frame {frame}: {n} points on actor {id}, which is {'' if id in there else 'not '}there", n > 2000 if id in there else n < 500)
    check(f"frame {frame}: {wrong[carla.CAR]} points where the car's mirror image is", carla.PASSING in there or wrong[carla.CAR] < 500)

# The first sweep has no cars. The expected right-handed angle is positive to the left:
# the angle of the map, minus CARLA's angle, plus the mounting angle.
v1, service = render_service(address)
scene = service.ListScenes(v1.ListScenesRequest()).scenes[0]
request = v1.RenderLidarRequest(sensor=v1.Sensor(name="Pandar128"))
request.actors.SetInParent()
for frame in (0, 1, 2):
    t = frame * carla.TICK_S
    ego = carla.transform_of(carla.EGO, t)
    map_yaw, ego_yaw = np.radians(MAP[3]), np.radians(MAP[3] - ego.rotation.yaw)
    at = complex(MAP[0], MAP[1]) + np.exp(1j * map_yaw) * complex(ego.location.x, -ego.location.y) + np.exp(1j * ego_yaw) * complex(*MOUNT[:2])
    half = 0.5 * (ego_yaw + np.radians(MOUNT[3]))
    request.path.add(time_s=scene.begin_s + t, pose=v1.Pose(translation=v1.Vector(x=at.real, y=at.imag, z=MOUNT[2]),
                                                           rotation=v1.Quaternion(w=np.cos(half), z=np.sin(half))))
expected = np.frombuffer(service.RenderLidar(request, timeout=60).points.xyz_m, "<f4").reshape(-1, 3) * [1, -1, 1]
check(f"first scan: {len(clouds[2])} points, expected {len(expected)}", len(clouds[2]) == len(expected) > 100)
if len(clouds[2]) == len(expected):
    check(f"first scan: points are {abs(clouds[2][:, :3] - expected).max()} m off", np.allclose(clouds[2][:, :3], expected, atol=2e-3))
check("actors are left in the scene", not service.ListScenes(v1.ListScenesRequest()).scenes[0].spawned)

finish()
