# SPDX-License-Identifier: Apache-2.0
"""Decodes the VLP-16 recording of the tests of tier4/nebula (Apache-2.0), and compares it with the
points that nebula decoded. The recording is a rosbag2 of packets with two returns. nebula's points
are five PCD files. Every point of nebula must be a point of relidar, with its ring, range,
intensity, time and azimuth. Every point of relidar must be a point of nebula, except in the packet
at which nebula separates two clouds, because nebula loses some of its points.

Two differences are allowed. nebula places the blocks of a packet 110.592 us apart, although two
blocks belong to the same firings in this mode. Its times are therefore too large by this interval
for each earlier pair, and for the second block of a pair. nebula does not interpolate the azimuth
between firings for the last pair of a packet and for the second block of each pair. The azimuths of
these points deviate by up to 0.41 degrees.

   nebula_test.py RELIDAR WORK        77: numpy is missing, or RELIDAR_TEST_NEBULA names no folder with vlp16/
"""
import json
import os
import pathlib
import shutil
import sqlite3
import struct
import subprocess
import sys

try:
    import numpy as np
except ImportError as error:
    print(f"skipped: {error}")
    sys.exit(77)

RELIDAR, WORK = sys.argv[1], pathlib.Path(sys.argv[2])
DATA = pathlib.Path(os.environ.get("RELIDAR_TEST_NEBULA", "")) / "vlp16"
if not DATA.is_dir():
    print("skipped: RELIDAR_TEST_NEBULA names no folder with vlp16/")
    sys.exit(77)
BASE, BLOCK_S = 1673400471, 110.592e-6
PACKET_S = 12 * BLOCK_S
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("ring", "<u2"), ("azimuth", "<f4"), ("distance", "<f4"),
                  ("return_type", "u1"), ("time", "<f8")])


def stamps_of(bag):
    """Returns the stamps of the packets in seconds after BASE."""
    stamps = []
    for data, in sqlite3.connect(f"file:{bag}?mode=ro&immutable=1", uri=True).execute("SELECT data FROM messages"):
        at = 16 + struct.unpack_from("<I", data, 12)[0]
        at = (at - 4 + 3) // 4 * 4 + 4
        for k in range(struct.unpack_from("<I", data, at)[0]):
            s, ns = struct.unpack_from("<iI", data, at + 4 + 1216 * k)
            stamps.append(s - BASE + 1e-9 * ns)
    return np.array(stamps)


def points_of(log):
    """Returns the columns x y z intensity ring (from below) time."""
    head, rows = json.loads((log / "sequence.json").read_text()), []
    zero = 1e-9 * (head["start_unix_ns"] - BASE * 10**9)
    for frame in head["frames"]:
        scan = np.load(log / frame["scan"])
        for k in ("", "_2"):
            hit = scan["range" + k] > 0
            # nebula leaves out the vertical offsets of the manual
            p = scan["range" + k][hit][:, None] * scan["directions"][hit]
            rows.append(np.column_stack([p, 255 * scan["intensity" + k][hit], 15 - scan["ring"][hit],
                                         scan["time"][hit] + frame["time_s"] + zero]))
    return np.concatenate(rows)


def as_theirs(ours, stamps):
    """Returns our points with each time that nebula may assign. A point may belong to the packet
    before, because stamps jitter, and to the first or second block of a pair."""
    rows = []
    at = np.searchsorted(stamps, ours[:, 5] + 1e-6) - 1
    for back in (0, 1):
        offset = ours[:, 5] - stamps[at - back]
        pair = np.floor((offset + 1e-6) / BLOCK_S)
        for second in (0, 1):
            keep = (pair >= 0) & (pair < 6)
            theirs = stamps[at - back] + offset + (pair + second) * BLOCK_S
            rows.append(np.column_stack([ours, theirs, pair, np.arange(len(ours)), np.full(len(ours), second)])[keep])
    return np.concatenate(rows)


def main():
    shutil.rmtree(WORK, ignore_errors=True)
    WORK.mkdir(parents=True)
    subprocess.run([RELIDAR, "convert", DATA / "1673400471837873222", "--out", WORK / "log", "--set", "dataset.max_range_m=300"], check=True,
                   capture_output=True)
    stamps = stamps_of(DATA / "1673400471837873222" / "1673400471837873222_0.db3")
    all_of_ours = points_of(WORK / "log")
    ours = as_theirs(all_of_ours, stamps)
    ours = ours[np.argsort(ours[:, 6])]
    ends = all_of_ours[:, 5].max()   # end of the last complete turn
    failed, seen = 0, set()
    for pcd in sorted(DATA.glob("*.pcd")):
        points = np.frombuffer(pcd.read_bytes().split(b"DATA binary\n", 1)[1], POINT)
        lost, n, beside = 0, 0, np.zeros(6)
        for p in points:
            t = p["time"] - BASE
            if t > ends:
                continue
            n += 1
            c = ours[np.searchsorted(ours[:, 6], t - 2e-6):np.searchsorted(ours[:, 6], t + 2e-6)]
            c = c[(c[:, 4] == p["ring"]) & (np.abs(np.linalg.norm(c[:, :3], axis=1) - p["distance"]) < 1e-4) & (np.abs(c[:, 3] - p["intensity"]) < 1e-3)]
            azimuth = np.degrees(np.arctan2(c[:, 1], c[:, 0]))
            apart = np.abs((azimuth + p["azimuth"] / 100 + 180) % 360 - 180)
            fits = apart < np.where((c[:, 7] == 5) | (c[:, 9] == 1), 0.41, 0.0051)
            if not fits.any():
                lost += 1
                continue
            best = c[fits][apart[fits].argmin()]
            seen.update(int(i) for i in c[fits][:, 8])
            which = 5 if best[9] else int(best[7])
            beside[which] = max(beside[which], apart[fits].min())
        print(f"{pcd.name}: {n} points of {len(points)} in whole turns, {lost} are not there; degrees beside theirs by pair (the last one: and second blocks): {beside.round(4)}")
        failed += lost
    begins = np.array(sorted(np.frombuffer(pcd.read_bytes().split(b"DATA binary\n", 1)[1], POINT)["time"].min() for pcd in DATA.glob("*.pcd")))
    begins -= BASE
    # excludes the ends, because the times of nebula are too large
    inside = (all_of_ours[:, 5] > begins[0] + PACKET_S) & (all_of_ours[:, 5] < ends - PACKET_S)
    more = [i for i in np.flatnonzero(inside) if int(i) not in seen]
    seam_s = max((np.abs(begins - all_of_ours[i, 5]).min() for i in more), default=0.0)
    print(f"{len(more)} of {inside.sum()} points of relidar are none of theirs, up to {1e3 * seam_s:.2f} ms from where one of their clouds begins")
    if seam_s > PACKET_S:
        sys.exit("FAILED: points that are none of theirs, beside the packet in which they part two clouds")
    sys.exit(f"FAILED: {failed} points are not there" if failed else 0)


main()
