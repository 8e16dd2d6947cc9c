#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares a rendering with `--frame world` at large coordinates with one at small coordinates. Reads
the files by the descriptions of their formats only.

  read_world.py SMALL LARGE X Y Z [MAP]

Both folders have npz, ply, pcd, las and bin files of the same scans. The world of LARGE is shifted by
X Y Z. All its points must be within 1 mm of those of the npz in SMALL. MAP is a LAS file of
`relidar export --points` of LARGE. Prints errors and exits with code 1 if a check fails.
"""
import json
import struct
import sys

import numpy as np
from checks import check, finish
from read_scans import read_pcd, read_ply, xyz

LAS_POINT = [("x", "<i4"), ("y", "<i4"), ("z", "<i4"), ("intensity", "<u2"), ("returns", "u1"), ("flags", "u1"),
             ("class", "u1"), ("user", "u1"), ("angle", "<i2"), ("source", "<u2"), ("time", "<f8")]
LAS_EXTRA = {3: "<u2", 6: "<i4", 9: "<f4"}


def read_las(path):
    """Returns points, intensities and a dict of the other fields."""
    data = open(path, "rb").read()
    begin, n_records, kind, size = struct.unpack_from("<IIBH", data, 96)
    n = struct.unpack_from("<Q", data, 247)[0]
    scale, offset = (np.array(struct.unpack_from("<3d", data, at)) for at in (131, 155))
    check(f"{path}: header", data[:4] == b"LASF" and data[24:26] == b"\1\4" and kind == 6 and len(data) == begin + n * size)
    fields, at = list(LAS_POINT), 375
    for _ in range(n_records):
        user, number, length = struct.unpack_from("<2x16sHH", data, at)
        if user.rstrip(b"\0") == b"LASF_Spec" and number == 4:
            for extra in range(at + 54, at + 54 + length, 192):
                fields.append((data[extra + 4:extra + 36].rstrip(b"\0").decode(), LAS_EXTRA[data[extra + 2]]))
        at += 54 + length
    check(f"{path}: records end at {at}, points begin at {begin}", at == begin and np.dtype(fields).itemsize == size)
    table = np.frombuffer(data, fields, n, begin)
    points = scale * xyz(table) + offset
    box = np.array(struct.unpack_from("<6d", data, 179)).reshape(3, 2)
    check(f"{path}: bounds", np.allclose(points.max(0), box[:, 0], atol=1e-9, rtol=0) and np.allclose(points.min(0), box[:, 1], atol=1e-9, rtol=0))
    returns = np.bincount(table["returns"] & 15, minlength=16)[1:]
    check(f"{path}: counts of returns", np.array_equal(returns, struct.unpack_from("<15Q", data, 255)))
    return points, table


def check_scan(small, large, summary, shift, scan):
    stem = f"frame_{scan['frame_number']:06}"
    truth, npz = np.load(f"{small}/{stem}.npz"), np.load(f"{large}/{stem}.npz")
    check(f"{stem}.npz: types", truth["points"].dtype == npz["points"].dtype == npz["origin"].dtype == np.float64)
    kept = (truth["drop_prob"] < 0.5) & (truth["median_range"] > 0)
    expected = truth["points"][kept] + shift
    las, table = read_las(f"{large}/{stem}.las")
    local = np.fromfile(f"{large}/{stem}.bin", "<f4").reshape(-1, 4)[:, :3].astype(float)
    pcd, viewpoint = read_pcd(f"{large}/{stem}.pcd")
    check(f"{stem}.pcd: VIEWPOINT", viewpoint == [0, 0, 0, 1, 0, 0, 0])
    clouds = {"npz": npz["points"][kept], "ply": xyz(read_ply(f"{large}/{stem}.ply")[0]), "pcd": xyz(pcd),
              "las": las, "bin": local + summary.get("world_offset_m", 0)}
    for kind, points in clouds.items():
        off = np.abs(points - expected).max() if points.shape == expected.shape else np.inf
        check(f"{stem}.{kind}: {off} m off", off < 1e-3)
    origins = npz["origin"] - shift - truth["origin"]
    check(f"{stem}.npz: origins are {np.abs(origins).max()} m off", np.abs(origins).max() < 1e-3)
    for name in ("ring", "instance"):
        check(f"{stem}.las: {name}", np.array_equal(table[name], npz[name][kept]))
    check(f"{stem}.las: times", np.allclose(table["time"], npz["time_s"] + npz["time"][kept], atol=1e-7))
    check(f"{stem}.las: intensities", np.abs(table["intensity"] / 65535 - npz["intensity"][kept]).max() < 1e-5)
    return las


def check_map(path, points, spacing):
    """Each cell has one point, and it is near the points of the scans."""
    found, _ = read_las(path)
    cells = np.unique(np.floor(found / spacing), axis=0)
    check(f"{path}: {len(found)} points in {len(cells)} cells", len(found) >= len(cells) > 0.99 * len(found) > 100)
    wanted = {tuple(cell) for cell in np.floor(points / spacing)}
    shared = sum(tuple(cell) in wanted for cell in np.floor(found / spacing)) / len(wanted)
    check(f"{path}: covers {shared} of the cells of the scans", 0.98 < shared < 1.02)


if __name__ == "__main__":
    summary = json.load(open(sys.argv[2] + "/scans.json"))
    shift = np.array([float(v) for v in sys.argv[3:6]])
    clouds = [check_scan(sys.argv[1], sys.argv[2], summary, shift, scan) for scan in summary["scans"]]
    check("scans.json names no scan", len(clouds) > 0)
    if len(sys.argv) > 6:
        check_map(sys.argv[6], np.concatenate(clouds), 0.05)
    finish()
