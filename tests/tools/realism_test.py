# SPDX-License-Identifier: Apache-2.0
"""Tests tools/bench/realism on images of noise. It must not distinguish two sets of real scans, and
it must detect scans with shifted intensities. A missing scikit-learn, a wrong shape and a wrong
time must end with a message of a single line.

   realism_test.py SOURCE WORK        77: numpy is missing
"""
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
ROWS, COLUMNS, RENDERED, ALL = 8, 40, range(2, 6), range(8)
random = np.random.default_rng(1)


def image(shift=0.0, columns=COLUMNS):
    """Returns images of noise with ranges and intensities. A fifth of the rays has no return."""
    shape = (ROWS, columns)
    ranges = np.where(random.random(shape) < 0.2, 0.0, random.uniform(5.0, 6.0, shape)).astype(np.float32)
    return ranges, (random.uniform(0.2, 0.3, shape) + shift).astype(np.float32)


def write_log(folder):
    (folder / "scans").mkdir(parents=True)
    for number in ALL:
        ranges, intensity = image()
        np.savez(folder / f"scans/{number:06}.npz", range=ranges, intensity=intensity)
    frames = [{"number": n, "time_s": 0.1 * n, "lidar": "", "scan": f"scans/{n:06}.npz"} for n in ALL]
    (folder / "sequence.json").write_text(json.dumps({"lidars": [{"name": ""}], "frames": frames}))


def write_scans(folder, late_s=0.0, **how):
    folder.mkdir()
    (folder / "scans.json").write_text(json.dumps({"points": {"range": "median"}}))
    for number in RENDERED:
        ranges, intensity = image(**how)
        np.savez(folder / f"frame_{number:06}.npz", median_range=ranges, range=np.zeros_like(ranges), intensity=intensity,
                 drop_prob=(ranges == 0.0).astype(np.float32), frame_number=number, time_s=0.1 * number + late_s)


def realism(*folders, path=None):
    environment = dict(os.environ, OMP_NUM_THREADS="1", **({"PYTHONPATH": str(path)} if path else {}))
    return subprocess.run([sys.executable, "-B", SOURCE / "tools/bench/realism", WORK / "log", *(WORK / f for f in folders)],
                          capture_output=True, text=True, env=environment)


def fails(text, *folders, path=None):
    told = realism(*folders, path=path)
    expect(told.returncode == 1 and text in told.stderr and told.stderr.count("\n") == 1, f"{text}: {told.stderr}")


def aucs(told, view):
    line = next(line for line in told.stdout.splitlines() if line.startswith(f"by {view}"))
    return [float(word) for word, sign in zip(line.split(), line.split()[1:]) if sign == "±"]


shutil.rmtree(WORK, ignore_errors=True)
write_log(WORK / "log")
write_scans(WORK / "brighter", shift=0.2)
write_scans(WORK / "narrow", columns=COLUMNS - 1)
write_scans(WORK / "late", late_s=0.05)
(WORK / "without/sklearn").mkdir(parents=True)
(WORK / "without/sklearn/__init__.py").write_text("raise ImportError(\"No module named 'sklearn'\")\n")
fails("scikit-learn", "brighter", path=WORK / "without")
try:
    import sklearn  # noqa: F401
except ImportError as error:
    print(f"skipped: {error}")
    sys.exit(77)
fails("(8, 40)", "narrow")
fails("0.2 s", "late")
told = realism("brighter")
expect(told.returncode == 0, told.stderr)
brighter, control = aucs(told, "intensity")
expect(abs(control - 0.5) < 0.12 and brighter > 0.99, told.stdout)
expect(all(abs(auc - 0.5) < 0.12 for view in ("range", "mask") for auc in aucs(told, view)), told.stdout)
