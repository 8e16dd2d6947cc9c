# SPDX-License-Identifier: Apache-2.0
"""Shared by the tests of recordings: arguments, runs of relidar, messages and scans. A test is
called as `NAME_test.py RELIDAR WORK`. Exits with 77 (skipped) if numpy or a program is missing."""
import json
import pathlib
import shutil
import subprocess
import sys

try:
    import numpy as np
except ImportError as error:
    print(f"skipped: {error}")
    sys.exit(77)

RELIDAR, WORK = sys.argv[1], pathlib.Path(sys.argv[2])
TYPE_CODES = {"i1": 1, "u1": 2, "i2": 3, "u2": 4, "i4": 5, "u4": 6, "f4": 7, "f8": 8, "i8": 9, "u8": 10}


def expect(condition, text):
    if not condition:
        sys.exit(f"FAILED: {text}")


def run(*arguments, code=0):
    """Returns what relidar prints."""
    done = subprocess.run([RELIDAR, *map(str, arguments)], capture_output=True, text=True)
    expect(done.returncode == code, f"relidar {' '.join(map(str, arguments))}: exit {done.returncode}\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def convert(recording, *settings):
    """Converts a recording to a log. Returns its folder, its sequence.json and its notes as text.
    @param settings settings (name=value) and other arguments"""
    folder = WORK / (recording.name + ".log")
    shutil.rmtree(folder, ignore_errors=True)
    run("convert", recording, "--out", folder, "--set", "dataset.max_range_m=200",
        *[a for s in settings for a in (("--set", s) if "=" in s else (s,))])
    head = json.loads((folder / "sequence.json").read_text())
    return folder, head, "\n".join(head["notes"])


def run_tests(*tests, programs=()):
    for program in programs:
        if not shutil.which(program):
            print(f"skipped: {program} is missing")
            sys.exit(77)
    shutil.rmtree(WORK, ignore_errors=True)
    WORK.mkdir(parents=True)
    for test in tests:
        test()
        print(test.__name__)


def header(stamp, frame):
    return {"stamp": stamp, "frame_id": frame}


def cloud(stamp, frame, rows, names=None):
    """Returns a PointCloud2 of a structured array, in the order of its transpose."""
    fields = [{"name": n, "offset": rows.dtype.fields[n][1], "datatype": TYPE_CODES[rows.dtype[n].str[1:]], "count": 1}
              for n in names or rows.dtype.names]
    return {"header": header(stamp, frame), "height": 1, "width": rows.size, "fields": fields, "is_bigendian": 0,
            "point_step": rows.itemsize, "row_step": rows.nbytes, "data": rows.T.tobytes(), "is_dense": 1}


def pose(place, yaw=0.0):
    return {"position": dict(zip("xyz", map(float, place))),
            "orientation": {"x": 0.0, "y": 0.0, "z": float(np.sin(yaw / 2)), "w": float(np.cos(yaw / 2))}}


def transform(stamp, parent, child, place, yaw=0.0, quaternion=None):
    """@param quaternion  x y z w; None: only the yaw"""
    placed = pose(place, yaw)
    if quaternion is not None:
        placed["orientation"] = dict(zip("xyzw", quaternion))
    return {"header": header(stamp, parent), "child_frame_id": child, "transform": placed}


def turned(v, yaw):
    """Rotates vectors [..., 3] about z."""
    c, s, v = np.cos(yaw), np.sin(yaw), np.asarray(v)
    return np.stack([c * v[..., 0] - s * v[..., 1], s * v[..., 0] + c * v[..., 1], v[..., 2] + 0 * c], -1)


def zero_ns(head):
    """Returns the time of the clock that is 0 s in the log."""
    return head["start_unix_ns"]


def returns(scan, suffix=""):
    """Returns the points [n, 3] of the rays with a return, and which rays have one."""
    hit = scan["range" + suffix] > 0
    return (scan["origin"] + scan["range" + suffix][..., None] * scan["directions"])[hit], hit
