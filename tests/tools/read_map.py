#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Compares files on a map with the same files in the world of a dataset, with a transverse Mercator
projection and an ellipsoid of its own.

  read_map.py SCENE LOCAL.ply MAP.las LOCAL.csv MAP.csv LOCAL_SCANS MAP_SCANS

SCENE is the scene.json of the run. Its georeference has a plane that touches the earth as projection. The
maps are in EPSG:32632. The folders have ply files in the world, and las and ply files on the map. Positions
must agree within 1 cm. Prints errors and exits with code 1 if a check fails.
"""
import json
import pathlib
import sys

import numpy as np
from checks import check, finish
from read_scans import read_ply, xyz
from read_world import read_las

RADIUS, FLATTENING, MERIDIAN = 6378137.0, 1 / 298.257223563, np.radians(9.0)
E2 = FLATTENING * (2 - FLATTENING)


def geocentric(latitude, longitude, height):
    n = RADIUS / np.sqrt(1 - E2 * np.sin(latitude) ** 2)
    return np.array([(n + height) * np.cos(latitude) * np.cos(longitude), (n + height) * np.cos(latitude) * np.sin(longitude),
                     (n * (1 - E2) + height) * np.sin(latitude)])


def geodetic(points):
    x, y, z = points.T
    distance, latitude = np.hypot(x, y), np.arctan2(z, np.hypot(x, y) * (1 - E2))
    for _ in range(8):
        n = RADIUS / np.sqrt(1 - E2 * np.sin(latitude) ** 2)
        height = distance / np.cos(latitude) - n
        latitude = np.arctan2(z, distance * (1 - E2 * n / (n + height)))
    return latitude, np.arctan2(y, x), height


def utm(latitude, longitude):
    """The series of Krueger."""
    n = FLATTENING / (2 - FLATTENING)
    alpha = [n / 2 - 2 * n**2 / 3 + 5 * n**3 / 16, 13 * n**2 / 48 - 3 * n**3 / 5, 61 * n**3 / 240]
    s = 2 * np.sqrt(n) / (1 + n)
    t = np.sinh(np.arctanh(np.sin(latitude)) - s * np.arctanh(s * np.sin(latitude)))
    xi = np.arctan2(t, np.cos(longitude - MERIDIAN))
    eta = np.arctanh(np.sin(longitude - MERIDIAN) / np.sqrt(1 + t * t))
    series = [(np.cos(2 * j * xi) * np.sinh(2 * j * eta) * a, np.sin(2 * j * xi) * np.cosh(2 * j * eta) * a)
              for j, a in enumerate(alpha, 1)]
    scale = 0.9996 * RADIUS / (1 + n) * (1 + n**2 / 4 + n**4 / 64)
    return 500000 + scale * (eta + sum(x for x, _ in series)), scale * (xi + sum(y for _, y in series))


def on_map(points, place):
    w, x, y, z = place["rotation"]
    assert x == y == 0, "a rotation about the vertical"
    c, s = w * w - z * z, 2 * w * z
    east, north, up = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ (points - place["world_point_m"]).T
    latitude, longitude = np.radians([place["latitude_deg"], place["longitude_deg"]])
    e = np.array([-np.sin(longitude), np.cos(longitude), 0])
    u = np.array([np.cos(latitude) * np.cos(longitude), np.cos(latitude) * np.sin(longitude), np.sin(latitude)])
    points = geocentric(latitude, longitude, place["height_m"])[:, None] + np.outer(e, east) + np.outer(np.cross(u, e), north) + np.outer(u, up)
    latitude, longitude, height = geodetic(points.T)
    return np.column_stack([*utm(latitude, longitude), height])


def compare(name, found, local):
    expected = on_map(local.astype(float), PLACE)
    off = np.abs(found - expected).max() if found.shape == expected.shape else np.inf
    check(f"{name}: {off} m off", off < 0.01)


PLACE = json.load(open(sys.argv[1]))["georeference"]
compare(sys.argv[3], read_las(sys.argv[3])[0], xyz(read_ply(sys.argv[2])[0]))
check(f"{sys.argv[3]}: coordinate system", b'AUTHORITY["EPSG","32632"]' in open(sys.argv[3], "rb").read())
local, mapped = (np.loadtxt(path, delimiter=",", skiprows=1) for path in sys.argv[4:6])
compare(sys.argv[5], mapped[:, 1:4], local[:, 1:4])
# The directions of the path follow its positions.
ahead = np.column_stack([np.cos(np.radians(local[:, 4])), np.sin(np.radians(local[:, 4])), np.zeros(len(local))])
step = on_map(local[:, 1:4] + ahead, PLACE) - on_map(local[:, 1:4], PLACE)
check(f"{sys.argv[5]}: yaw", np.abs(np.degrees(np.arctan2(step[:, 1], step[:, 0])) - mapped[:, 4]).max() < 1e-3)
for path in pathlib.Path(sys.argv[6]).glob("*.ply"):
    local = read_ply(path)[0]
    compare(f"{path.stem}.las", read_las(f"{sys.argv[7]}/{path.stem}.las")[0], xyz(local))
    mapped = read_ply(f"{sys.argv[7]}/{path.name}")[0]
    compare(path.name, xyz(mapped), xyz(local))
    normals, found = (np.column_stack([table[axis] for axis in ("nx", "ny", "nz")]) for table in (local, mapped))
    turned = on_map(xyz(local).astype(float) + normals, PLACE) - on_map(xyz(local).astype(float), PLACE)
    check(f"{path.name}: normals", np.abs(turned - found).max() < 1e-3)
finish()
