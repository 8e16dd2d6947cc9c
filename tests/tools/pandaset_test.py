# SPDX-License-Identifier: Apache-2.0
"""Tests tools/pandaset_to_folder on a tiny sequence in the format of PandaSet. A Pandar64 with
exact rays measures a ground and a round wall from a car that drives a bend. The points are
transformed to the world by the pose of each sweep or of each point.

   pandaset_test.py SOURCE RELIDAR WORK        77: numpy or pandas are missing
"""
import csv
import json
import pathlib
import shutil
import subprocess
import sys

try:
    import numpy as np
    import pandas as pd
except ImportError as error:
    print(f"skipped: {error}")
    sys.exit(77)

from checks import expect   # noqa: E402

SOURCE, RELIDAR, WORK = pathlib.Path(sys.argv[1]), sys.argv[2], pathlib.Path(sys.argv[3])
N_FRAMES, COLUMNS, START = 4, 360, 1557546260.0


def pose(t):
    """Returns the position and heading angle of the sensor in the world: a bend at 15 m/s and 0.3
    rad/s. The quaternion changes at a constant rate, as in slerp."""
    yaw = 0.4 + 0.3 * t
    return np.stack([100 + 50 * np.sin(0.3 * t), -40 - 50 * np.cos(0.3 * t), np.full_like(t, 1.9)], -1), yaw


def turned(v, yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    return np.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1], v[..., 2]], -1)


def straight(t, times):
    """Returns poses between the poses of the sweeps, interpolated as a reader of the files does.
    Positions and, for small turns, angles are linear."""
    p, yaw = pose(times)
    k = np.clip(np.searchsorted(times, t, side="right") - 1, 0, len(times) - 2)
    s = (t - times[k]) / (times[k + 1] - times[k])
    return p[k] + s[..., None] * (p[k + 1] - p[k]), yaw[k] + s * (yaw[k + 1] - yaw[k])


def sweep(number):
    """Returns points in the sensor's frame (x right, y forward) and their times. The head turns
    clockwise, and times range from -0.05 s to 0.05 s relative to the sweep."""
    with open(SOURCE / "src/log/sensor/tables/Pandar64.csv") as file:
        beams = list(csv.DictReader(line for line in file if not line.startswith("#")))
    elevation = np.radians([float(b["elevation_deg"]) for b in beams])[:, None]
    offset = np.radians([float(b["azimuth_offset_deg"]) for b in beams])[:, None]
    step = np.arange(COLUMNS)[None, :] + 0.5
    forward = np.pi - 2 * np.pi * step / COLUMNS + offset   # angle to the left of y
    t = np.broadcast_to(0.1 * number + 0.1 * (step / COLUMNS - 0.5), forward.shape)
    direction = np.stack([-np.sin(forward) * np.cos(elevation), np.cos(forward) * np.cos(elevation), np.sin(elevation) + 0 * forward], -1)
    ground = np.where(direction[..., 2] < 0, 1.9 / np.maximum(-direction[..., 2], 1e-9), np.inf)
    wall = (25 + 3 * np.sin(5 * forward)) / np.cos(elevation)
    reach = np.minimum(ground, wall)
    return (direction * reach[..., None]).reshape(-1, 3), t.reshape(-1)


def write(folder, compensated):
    shutil.rmtree(folder, ignore_errors=True)
    (folder / "lidar").mkdir(parents=True)
    (folder / "annotations/cuboids").mkdir(parents=True)
    times = 0.1 * np.arange(N_FRAMES)
    p, yaw = pose(times)
    poses = [{"position": dict(zip("xyz", map(float, p[i]))),
              "heading": {"w": float(np.cos(yaw[i] / 2)), "x": 0.0, "y": 0.0, "z": float(np.sin(yaw[i] / 2))}} for i in range(N_FRAMES)]
    (folder / "lidar/poses.json").write_text(json.dumps(poses))
    (folder / "lidar/timestamps.json").write_text(json.dumps([START + t for t in times]))
    for i in range(N_FRAMES):
        points, t = sweep(i)
        at, heading = straight(t if compensated else np.full_like(t, times[i]), times)
        world = at + turned(points, heading)
        table = pd.DataFrame({"x": world[:, 0], "y": world[:, 1], "z": world[:, 2], "i": np.arange(len(t)) % 256.0, "t": START + t, "d": 0})
        other = table.iloc[:50].assign(d=1, x=0.0)
        pd.concat([table, other]).to_pickle(folder / f"lidar/{i:02}.pkl.gz")
        cuboid = {"uuid": "car-a", "label": "Car", "yaw": 0.25, "stationary": False, "position.x": 120.0 + i, "position.y": -60.0,
                  "position.z": 0.8, "dimensions.x": 1.9, "dimensions.y": 4.6, "dimensions.z": 1.5, "cuboids.sensor_id": 0,
                  "cuboids.sibling_id": "car-b"}
        twin = dict(cuboid, **{"uuid": "car-b", "cuboids.sensor_id": 1, "cuboids.sibling_id": "car-a"})
        pd.DataFrame([cuboid, twin]).to_pickle(folder / f"annotations/cuboids/{i:02}.pkl.gz")


def convert(*arguments):
    return subprocess.run([sys.executable, SOURCE / "tools/pandaset_to_folder", *map(str, arguments)], capture_output=True, text=True)


def check(compensated):
    folder, out = WORK / "001", WORK / f"out_{compensated}"
    write(folder, compensated)
    shutil.rmtree(out, ignore_errors=True)
    made = convert(folder, "--out", out)
    expect(made.returncode == 0, made.stderr)
    expect(("each point" if compensated else "the sweep") in made.stdout, f"found the wrong way: {made.stdout}")
    for i in range(N_FRAMES):
        points, t = sweep(i)
        truth = np.stack([points[:, 1], -points[:, 0], points[:, 2]], -1)
        scan = np.load(out / f"scans/{i:06}.npy")
        expect(len(scan) == len(truth), f"{len(scan)} points, expected {len(truth)} of the Pandar64 alone")
        away = np.linalg.norm(scan[:, :3] - truth, axis=1).max()
        expect(away < 1e-3, f"points are {away} m off")
        expect(np.abs(scan[:, 4] - (t - 0.1 * i)).max() < 1e-5, "times are off")
    lines = np.loadtxt(out / "poses.txt")
    position, yaw = pose(0.1 * np.arange(N_FRAMES))
    expect(np.abs(lines[:, 1:4] - position).max() < 1e-8, "positions are off")
    ahead = 2 * np.arctan2(lines[:, 7], lines[:, 4]) - yaw   # y is forward in PandaSet
    expect(np.abs(np.remainder(ahead, 2 * np.pi) - np.pi / 2).max() < 1e-8, "headings are off")
    boxes = json.loads((out / "boxes.json").read_text())["boxes"]
    expect([b["track"] for b in boxes] == ["car-a"] * N_FRAMES, "the twin of a box is one box")
    expect(boxes[0]["size"] == [4.6, 1.9, 1.5] and abs(boxes[0]["yaw_deg"] - (np.degrees(0.25) + 90)) < 1e-9, f"box {boxes[0]}")
    told = subprocess.run([RELIDAR, "info", out, "--json"], capture_output=True, text=True)
    expect(told.returncode == 0, told.stderr)
    log = json.loads(told.stdout)
    expect(log["frames"] == N_FRAMES and log["lidars"][0]["rows"] == 64 and len(log["boxes"]) == 1, told.stdout)
    expect(convert(folder, "--out", out).returncode == 1, "a folder that is there is not written over")


def check_bad():
    folder = WORK / "001"
    for name, text, word in [("lidar/timestamps.json", "[1.0]", "poses for 1 timestamps"), ("lidar/poses.json", "{", "expected a JSON file"),
                             ("lidar/00.pkl.gz", "no pickle", "expected a pickled table")]:
        write(folder, False)
        (folder / name).write_text(text)
        made = convert(folder, "--out", WORK / "bad")
        shutil.rmtree(WORK / "bad", ignore_errors=True)
        expect(made.returncode == 1 and word in made.stderr and made.stderr.count("\n") == 1, f"{name}: {made.stderr}")


WORK.mkdir(parents=True, exist_ok=True)
for way in (False, True):
    check(way)
check_bad()
print("ok")
