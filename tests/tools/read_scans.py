#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Reads renderings with numpy and the descriptions of the file formats only. It uses no code of
relidar.

  read_scans.py FOLDER [FOLDER_WORLD FOLDER_DESKEWED]

FOLDER has npz, ply, pcd and bin files of the same scans. All files must contain the points that the
images of the npz define. FOLDER_WORLD and FOLDER_DESKEWED contain npz and ply of the same frames,
in the world and deskewed. The pose must transform the deskewed points to the world. Prints errors
and exits with code 1 if a check fails.
"""
import json
import sys

import numpy as np
from checks import check, finish

NORMAL_FIELDS = {"ply": ("nx", "ny", "nz"), "pcd": ("normal_x", "normal_y", "normal_z")}
PLY_TYPES = {"float": "<f4", "double": "<f8", "uint16": "<u2", "int": "<i4"}
def read_ply(path):
    data = open(path, "rb").read()
    header, body = data.split(b"end_header\n", 1)
    lines = header.decode().splitlines()
    check(f"{path}: magic", lines[:2] == ["ply", "format binary_little_endian 1.0"])
    n = next(int(line.split()[2]) for line in lines if line.startswith("element vertex"))
    dtype = np.dtype([(line.split()[2], PLY_TYPES[line.split()[1]]) for line in lines if line.startswith("property")])
    check(f"{path}: size", len(body) == n * dtype.itemsize)
    notes = dict(line.split(" ", 2)[1:] for line in lines if line.startswith("comment"))
    return np.frombuffer(body, dtype, n), notes


def read_pcd(path):
    data = open(path, "rb").read()
    header, body = data.split(b"DATA binary\n", 1)
    entry = {line.split(" ")[0]: line.split(" ")[1:] for line in header.decode().splitlines() if not line.startswith("#")}
    kinds = zip(entry["FIELDS"], entry["TYPE"], entry["SIZE"])
    dtype = np.dtype([(name, f"<{kind.lower()}{size}") for name, kind, size in kinds])
    n = int(entry["POINTS"][0])
    check(f"{path}: size", len(body) == n * dtype.itemsize and n == int(entry["WIDTH"][0]) * int(entry["HEIGHT"][0]))
    return np.frombuffer(body, dtype, n), [float(v) for v in entry["VIEWPOINT"]]


def matrix_of(viewpoint):
    x, y, z, qw, qx, qy, qz = viewpoint
    return np.array([[1 - 2 * (qy * qy + qz * qz), 2 * (qx * qy - qz * qw), 2 * (qx * qz + qy * qw), x],
                     [2 * (qx * qy + qz * qw), 1 - 2 * (qx * qx + qz * qz), 2 * (qy * qz - qx * qw), y],
                     [2 * (qx * qz - qy * qw), 2 * (qy * qz + qx * qw), 1 - 2 * (qx * qx + qy * qy), z],
                     [0, 0, 0, 1]])


def xyz(cloud):
    return np.stack([cloud[axis] for axis in "xyz"], axis=-1).astype(float)


def check_normals(stem, npz):
    """Checks that rays with a hit have unit normals that face the sensor."""
    lengths = np.linalg.norm(npz["normal"], axis=-1)
    check(f"{stem}: lengths of normals", np.allclose(lengths, npz["instance"] >= 0, atol=1e-5))
    check(f"{stem}: normals look away", (npz["normal"] * npz["directions"]).sum(axis=-1).max() <= 1e-5)


def check_scan(folder, summary, scan):
    stem = f"{folder}/frame_{scan['frame_number']:06}"
    npz = np.load(stem + ".npz")
    shape = npz["range"].shape
    for name in ("median_range", "intensity", "drop_prob", "weight", "time", "ring", "instance"):
        check(f"{stem}: shape of {name}", npz[name].shape == shape)
    check(f"{stem}: types", npz["ring"].dtype == np.uint16 and npz["time"].dtype == np.float32 and npz["pose"].dtype == np.float64)
    check(f"{stem}: pose", np.array_equal(npz["pose"], scan["world_from_sensor"]) and npz["time_s"] == scan["time_s"])
    check(f"{stem}: names", npz["sensor"].item() == summary["sensor"]["name"] and npz["run"].item() == summary["run"])
    check(f"{stem}: directions", np.allclose(np.linalg.norm(npz["directions"], axis=-1), 1, atol=1e-5))
    points_range = np.where(npz["median_range"] > 0, npz["median_range"], npz["range"])
    kept = (npz["drop_prob"] < 0.5) & (points_range > 0)
    for values in (points_range[kept], npz["range"][kept]):
        check(f"{stem}: range limits", values.max() <= summary["sensor"]["max_range_m"] and values.min() >= summary["sensor"]["min_range_m"])
    points = npz["points"][kept]
    rays = (npz["origin"] + points_range[..., None] * npz["directions"])[kept]
    check(f"{stem}: points are {abs(points - rays).max()} m off the rays", np.allclose(points, rays, atol=1e-4))
    ply, notes = read_ply(stem + ".ply")
    pcd, viewpoint = read_pcd(stem + ".pcd")
    check(f"{stem}: points", len(points) == scan["points"] > 0)
    for name, cloud in (("ply", ply), ("pcd", pcd)):
        of_normals = NORMAL_FIELDS[name] if "normal" in npz else ()
        of_spread = ("spread",) if "spread" in npz else ()
        check(f"{stem}.{name}: fields", cloud.dtype.names == ("x", "y", "z", "intensity", "ring", "time", "instance") + of_normals + of_spread)
        for axis, field in enumerate(of_normals):
            check(f"{stem}.{name}: {field}", np.array_equal(cloud[field], npz["normal"][kept][:, axis]))
        check(f"{stem}.{name}: points", np.array_equal(xyz(cloud), points))
        for field in ("intensity", "ring", "time", "instance") + of_spread:
            check(f"{stem}.{name}: {field}", np.array_equal(cloud[field], npz[field][kept]))
    if "normal" in npz:
        check_normals(stem, npz)
    if "spread" in npz:   # with render.range=normalised, the image contains the mean range
        check(f"{stem}: spread", np.allclose(npz["spread"], np.abs(npz["median_range"] - npz["range"]), atol=1e-6) and npz["spread"].max() > 0)
    check(f"{stem}.pcd: VIEWPOINT", np.allclose(matrix_of(viewpoint), npz["pose"], atol=1e-12))
    check(f"{stem}.ply: comments", float(notes["time_s"]) == npz["time_s"] and notes["sensor"] == summary["sensor"]["name"])
    check(f"{stem}.ply: pose", np.array_equal(np.array(notes["world_from_sensor"].split(), float).reshape(4, 4), npz["pose"]))
    check(f"{stem}.bin", np.array_equal(np.fromfile(stem + ".bin", "<f4").reshape(-1, 4)[:, :3], points))


def check_frames(plain, world, deskewed, scan):
    """Checks that world points are the deskewed points transformed by the scan's pose, and that
    deskewed points differ from the measured points."""
    name = f"frame_{scan['frame_number']:06}"
    pose = np.load(f"{plain}/{name}.npz")["pose"]
    clouds = [xyz(read_ply(f"{folder}/{name}.ply")[0]) for folder in (plain, world, deskewed)]
    check(f"{world}/{name}: world is not pose times deskewed", np.allclose(clouds[1], clouds[2] @ pose[:3, :3].T + pose[:3, 3], atol=1e-4))
    moved = np.abs(clouds[2] - clouds[0]).max()
    check(f"{deskewed}/{name}: moved by {moved} m, expected what a sensor drives in half a sweep", 0.01 < moved < 5)
    npz = np.load(f"{world}/{name}.npz")
    check(f"{world}/{name}: frame", npz["frame"].item() == "world" and npz["deskewed"] == 1)
    check(f"{world}/{name}: origins", np.abs(npz["origin"] - pose[:3, 3]).max() < 5)


if __name__ == "__main__":
    summary = json.load(open(sys.argv[1] + "/scans.json"))
    for scan in summary["scans"]:
        check_scan(sys.argv[1], summary, scan)
        if len(sys.argv) > 3:
            check_frames(*sys.argv[1:4], scan)
    check("scans.json names no scan", len(summary["scans"]) > 0)
    finish()
