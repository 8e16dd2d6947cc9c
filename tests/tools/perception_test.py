# SPDX-License-Identifier: Apache-2.0
"""Tests tools/bench/perception with a program in the place of relidar, whose scans are exact. The
simulated sensor moves by 2 % more than its poses say, and one of seven cubes is missing.

   perception_test.py SOURCE WORK        77: numpy or PCL are missing
"""
import importlib.machinery
import importlib.util
import json
import os
import pathlib
import shutil
import subprocess
import sys

try:
    import numpy as np
except ImportError as error:
    print(f"skipped: {error}")
    sys.exit(77)

from checks import expect   # noqa: E402

SOURCE, WORK = pathlib.Path(sys.argv[1]), pathlib.Path(sys.argv[2])
PROGRAM = SOURCE / "tools/bench/perception"
N_FRAMES, STEP_M, STRETCH, CUBE_M, HEIGHT_M = 4, 0.5, 1.02, 2.0, 1.7
CUBES = [(12, 5), (12, -6), (-9, 6), (-10, -7), (4, 11), (3, -12), (18, 0)]
PCL = ("pcl_registration", "pcl_segmentation", "pcl_filters", "pcl_kdtree")

# Writes the answers of `relidar render` and of `relidar convert` that lie next to it.
RELIDAR = f"""#!{sys.executable}
import pathlib, shutil, sys
shutil.copytree(pathlib.Path(__file__).parent / sys.argv[1], sys.argv[sys.argv.index("--out") + 1])
"""


def make_world(n_cubes):
    """Returns points of a plane and of the sides of cubes on it."""
    random = np.random.default_rng(1)
    plane = np.c_[random.uniform(-25, 25, (40000, 2)), np.full(40000, -HEIGHT_M)]
    parts = [plane]
    for x, y in CUBES[:n_cubes]:
        side = random.uniform(-1, 1, (3000, 3)) * CUBE_M / 2
        axis = random.integers(0, 2, 3000)
        side[np.arange(3000), axis] = np.sign(side[np.arange(3000), axis]) * CUBE_M / 2
        parts.append(side + (x, y, CUBE_M / 2 - HEIGHT_M))
    return np.concatenate(parts)


def write_answers():
    (WORK / "render").mkdir()
    (WORK / "convert/scans").mkdir(parents=True)
    scans = []
    for frame in range(N_FRAMES):
        pose = np.eye(4)
        pose[0, 3] = frame * STEP_M
        scans.append({"frame_number": frame, "world_from_sensor": pose.tolist()})
        real = make_world(len(CUBES)) - pose[:3, 3]
        range_m = np.linalg.norm(real, axis=1)
        np.savez(WORK / f"convert/scans/{frame}.npz", origin=np.zeros((1, len(real), 3)), directions=(real / range_m[:, None])[None],
                 range=range_m[None].astype(np.float32), intensity=np.zeros((1, len(real)), np.float32))
        simulated = make_world(len(CUBES) - 1) - STRETCH * pose[:3, 3]
        np.c_[simulated, np.zeros(len(simulated))].astype(np.float32).tofile(WORK / f"render/frame_{frame:06}.bin")
    (WORK / "render/scans.json").write_text(json.dumps({"scans": scans}))
    frames = [{"number": n, "lidar": "", "scan": f"scans/{n}.npz"} for n in range(N_FRAMES)]
    (WORK / "convert/sequence.json").write_text(json.dumps({"lidars": [{"name": ""}], "frames": frames}))
    (WORK / "run").mkdir()
    (WORK / "run/config.toml").write_text('[dataset]\npath = "log"\nskip_broken = false\n')
    splits = [{"index": n, "split": "test" if n == 2 else "train"} for n in range(N_FRAMES)]
    (WORK / "run/scene.json").write_text(json.dumps({"frames": splits}))
    (WORK / "relidar").write_text(RELIDAR)
    (WORK / "relidar").chmod(0o755)


def perception(run, out, **environment):
    return subprocess.run([sys.executable, "-B", PROGRAM, WORK / run, "--out", WORK / out, "--relidar", WORK / "relidar"],
                          capture_output=True, text=True, env=dict(os.environ, **environment))


shutil.rmtree(WORK, ignore_errors=True)
WORK.mkdir(parents=True)
write_answers()
refused = perception("none", "out0")
expect(refused.returncode == 1 and refused.stderr.count("\n") == 1, f"a run that does not exist: {refused.stderr}")
old = WORK / "out1/real/frame_000009.bin"
old.parent.mkdir(parents=True)
old.touch()
without = perception("run", "out1", PATH="", PYTHONPATH="")
expect(not old.exists(), "a scan of an earlier run is kept")
expect(without.returncode == 0, f"without PCL: {without.stderr}")
report = json.loads((WORK / "out1/perception.json").read_text())
expect(any("PCL" in line for line in report["skipped"]), f"PCL is not reported as skipped: {report['skipped']}")
rows = {row["title"]: row for row in report["rows"]}
n_plane_and_cubes = len(make_world(len(CUBES)))
expect(rows["points a scan"]["real"] == n_plane_and_cubes and rows["points a scan"]["simulated"] == n_plane_and_cubes - 3000,
       f"number of points: {rows['points a scan']}")

loader = importlib.machinery.SourceFileLoader("perception", str(PROGRAM))
module = importlib.util.module_from_spec(importlib.util.spec_from_loader("perception", loader))
loader.exec_module(module)
joined = module.equal_clusters(np, np.array([1, 1, 2, 2]), np.ones(4, int), np.arange(4))
expect(joined == 0, f"a cluster that joins two of the same size equals both: {joined}")
parts = [module.equal_clusters(np, np.ones(10, int), np.ones(n, int), np.arange(n)) for n in (4, 6)]
expect(parts == [0, 1], f"a cluster with 4 and 6 of 10 points: {parts}")

if any(shutil.which(tool) is None for tool in ("pkg-config", "c++")) or subprocess.run(["pkg-config", "--exists", *PCL]).returncode:
    print("skipped: pkg-config, a compiler or libpcl-dev are missing")
    sys.exit(77)
done = perception("run", "out2")
expect(done.returncode == 0, f"with PCL: {done.stderr}")
rows = {row["title"]: row for row in json.loads((WORK / "out2/perception.json").read_text())["rows"]}
along = rows["odometry, PCL GICP: error along the path, %"]
expect(abs(along["real"]) < 0.2 and abs(along["simulated"] - 100 * (STRETCH - 1)) < 0.2, f"error along the path: {along}")
n_cubes = len(CUBES)
expect([rows["clusters, PCL: number in a scan"][column] for column in ("real", "simulated")] == [n_cubes, n_cubes - 1],
       f"clusters: {rows['clusters, PCL: number in a scan']}")
equal = rows["clusters, PCL: F-score of equal clusters"]
expect(equal["real + 1 cm"] == 1 and abs(equal["simulated"] - 2 * (n_cubes - 1) / (2 * n_cubes - 1)) < 1e-9, f"equal clusters: {equal}")
ground = rows["ground, PCL: equal labels"]
expect(min(ground["real + 1 cm"], ground["simulated"]) > 0.99, f"ground: {ground}")
expect(done.stdout.count("|") > 50, "the table is not printed")
