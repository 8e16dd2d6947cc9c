# SPDX-License-Identifier: Apache-2.0
"""Tests ROS bags whose clouds are halves or slices of a turn, or not scans of a single LiDAR.
bag_writer.py writes the bags. A LiDAR of 8 beams measures an uneven hall. relidar must join the
parts to full turns with every point at its time, or report the contents of the clouds.

   bag_parts_test.py RELIDAR WORK        77: numpy is missing
"""
from bag_harness import WORK, cloud, convert, expect, np, returns, run, run_tests, zero_ns

import bag_writer as bags
from names import names

T0, TURN, N, ROWS, COLUMNS = 1_700_000_000_250_000_000, 100_000_000, 6, 8, 360
ELEVATIONS = np.radians(np.linspace(10, -25, ROWS))


def firings(first, last, clockwise=True, offset=(0, 0, 0)):
    """Returns the points of columns as x y z and time in ns from T0. Columns are counted from the
    start of the first turn, which is backward."""
    column = np.arange(first, last)
    azimuth = np.pi - 2 * np.pi * ((column + 0.5) % COLUMNS) / COLUMNS
    if not clockwise:
        azimuth = -azimuth
    range_m = 15 + 4 * np.sin(3 * azimuth) + np.arange(ROWS)[:, None] * 0.2
    e = ELEVATIONS[:, None]
    points = np.zeros((ROWS, len(column)), [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4"), ("t", "<u4"), ("ring", "<u2")])
    points["x"], points["y"] = range_m * np.cos(e) * np.cos(azimuth) + offset[0], range_m * np.cos(e) * np.sin(azimuth) + offset[1]
    points["z"], points["intensity"], points["ring"] = range_m * np.sin(e) + offset[2], 30, np.arange(ROWS)[:, None]
    return points, column * (TURN // COLUMNS)


def message(points, times_ns, frame="lidar", fields=("x", "y", "z", "intensity", "t", "ring")):
    points = points.copy()
    points["t"] = times_ns - times_ns[0]
    stamp = T0 + int(times_ns[0])
    return ("/points", "sensor_msgs/PointCloud2", stamp, cloud(stamp, frame, points, fields))


def converted(messages):
    bags.write_mcap(WORK / "parts.mcap", messages)
    folder, head, notes = convert(WORK / "parts.mcap")
    scans = []
    for frame in head["frames"]:
        scan = np.load(folder / frame["scan"])
        points, hit = returns(scan)
        scans.append((frame["time_s"], scan["range"].shape, scan["time"][hit] + frame["time_s"], points))
    return head, notes, scans


def check(name, columns, clockwise=True, lost=(), turns=range(N)):
    """@param columns first column of each part, and end of the last part"""
    parts = [message(*firings(a, b, clockwise)) for k, (a, b) in enumerate(zip(columns, columns[1:])) if k not in lost]
    head, notes, scans = converted(parts)
    expect("part of a revolution" in notes, f"{name}: {notes}")
    expect(len(scans) == len(turns), f"{name}: {len(scans)} turns, expected {len(turns)}\n{notes}")
    for (_, shape, times, points), turn in zip(scans, turns):
        truth, t_ns = firings(turn * COLUMNS, (turn + 1) * COLUMNS, clockwise)
        expect(shape == (ROWS, COLUMNS), f"{name}: an image of {shape}")
        key = np.lexsort((points[:, 2], times))
        wanted = np.stack([truth[a] for a in "xyz"], -1)
        t = np.broadcast_to(t_ns, truth.shape).ravel() * 1e-9
        order = np.lexsort((wanted.reshape(-1, 3)[:, 2], t))
        expect(len(times) == truth.size, f"{name}, turn {turn}: {len(times)} points, expected {truth.size}")
        expect(np.abs(np.sort(times) + 1e-9 * (zero_ns(head) - T0) - t[order]).max() < 2e-6, f"{name}, turn {turn}: times")
        # sorts the points of a firing by height, so that equal points are compared
        same = np.lexsort((points[:, 2], np.rint((times + 1e-9 * (zero_ns(head) - T0)) * 1e9 / (TURN // COLUMNS))))
        expect(np.abs(points[same] - wanted.reshape(-1, 3)[order]).max() < 1e-4, f"{name}, turn {turn}: points")
    expect(abs(head["lidars"][0]["sensor"]["spinning"]["period_s"] - 0.1) < 1e-3, f"{name}: a turn of {head['lidars'][0]['sensor']['spinning']['period_s']} s")


def test_joined():
    whole = COLUMNS * N
    check("halves", list(range(0, whole + 1, COLUMNS // 2)))
    check("halves, begun with a second one", list(range(COLUMNS // 2, whole + 1, COLUMNS // 2)), turns=range(1, N))
    check("ten slices", list(range(0, whole + 1, COLUMNS // 10)))
    check("ten slices, the other way round", list(range(0, whole + 1, COLUMNS // 10)), clockwise=False)
    check("ten slices, begun and ended within a turn, one lost", list(range(72, whole - 100, COLUMNS // 10)), lost=(20,), turns=(1, 3, 4))


def test_said():
    halves = [message(*firings(a, a + COLUMNS // 2), fields=("x", "y", "z", "intensity", "ring")) for a in range(0, COLUMNS * N, COLUMNS // 2)]
    bag = WORK / "said.mcap"
    bags.write_mcap(bag, halves)
    said = run("info", bag, code=3)
    expect("180 degrees" in said and "no usable times" in said, f"halves without times: {said}")
    for frame in ("map", "base_link"):
        turns = [message(*firings(k * COLUMNS, (k + 1) * COLUMNS), frame=frame) for k in range(N)]
        bags.write_mcap(bag, turns)
        said = run("info", bag, code=3 if frame == "map" else 0)
        expect(("world-fixed" if frame == "map" else "merged") in said, f"clouds in {frame}: {said}")
    merged = []
    for k in range(N):
        (a, t), (b, _) = firings(k * COLUMNS, (k + 1) * COLUMNS), firings(k * COLUMNS, (k + 1) * COLUMNS, offset=(2.0, 1.0, -1.5))
        merged.append(message(np.concatenate([a, b], 1), np.concatenate([t, t])))
    bags.write_mcap(bag, merged)
    said = run("info", bag)
    expect(names(said, "merged"), f"a merged cloud: {said}")


def test_left_alone():
    """Tests a LiDAR without a rotating head that sweeps a window to and fro. Each window must be a
    scan."""
    window = lambda k: firings(COLUMNS // 3, 2 * COLUMNS // 3)[0]
    times = lambda k: k * TURN + np.arange(COLUMNS // 3) * (TURN // (COLUMNS // 3))
    _, notes, scans = converted([message(window(k), times(k)) for k in range(N)])
    expect("part of a revolution" not in notes and len(scans) == N, f"windows: {len(scans)} scans\n{notes}")


run_tests(test_joined, test_said, test_left_alone)
