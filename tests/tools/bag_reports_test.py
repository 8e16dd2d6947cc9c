# SPDX-License-Identifier: Apache-2.0
"""Tests bags like those of public bug reports. A LiDAR drives along x at 10 m/s in a room that moves
with it. Scans and poses must be as written.

   bag_reports_test.py RELIDAR WORK        77: numpy, lz4 or zstd are missing
"""
import math
import os
import pathlib
import struct
import subprocess

from bag_harness import RELIDAR, WORK, convert, expect, np, returns, run, run_tests, transform
from bag_harness import cloud as cloud_of_rows

import bag_writer as bags
from names import names

T0, STEP, N, COLUMNS, ROWS, SPEED = 1_700_000_000_000_000_000, 100_000_000, 12, 90, 8, 10.0
SECOND = 1_000_000_000
TF, CLOUD, LIVOX = "tf2_msgs/TFMessage", "sensor_msgs/PointCloud2", "livox_ros_driver2/CustomMsg"


def points(columns=np.arange(COLUMNS)):
    """Returns [points, 3] of a sweep, column by column."""
    el, az = np.radians(4 * np.arange(ROWS) - 15), math.pi - 2 * math.pi * (columns[:, None] + .5) / COLUMNS
    d = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el) + 0 * az], -1)
    return (d * np.minimum(8 / abs(d[..., 1:2]), 30 / abs(d[..., :1]))).reshape(-1, 3).astype("f4")


def cloud(stamp, frame="lidar", late_s=lambda t: 0, kind="f4"):
    """@param late_s error of the time of each point"""
    p = points()
    row = np.zeros(len(p), [("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2"), ("time", kind)])
    row["x"], row["y"], row["z"] = p.T
    row["ring"], row["time"] = np.arange(len(p)) % ROWS, np.arange(len(p)) // ROWS * (0.1 / COLUMNS)
    row["time"] += late_s(row["time"])
    return cloud_of_rows(stamp, frame, row)


def log(n=N, ahead_ns=0, cloud_delay_ns=0, pose_delay_ns=0, start_s=-0.5, end_s=0.5, tf_extra=(), lidars=(("/points", "lidar"),)):
    """Returns the messages of a drive.
    @param ahead_ns the clock of the LiDAR minus the clock of poses and recorder
    @param start_s, end_s the poses begin and end this much after the scans"""
    out = [("/tf_static", TF, T0, {"transforms": [transform(T0, "base", "lidar", (0, 0, 1.8)), transform(T0, "base", "rear", (-2, 0, 1.8))]})]
    for t in range(round(start_s * 20), 2 * n + round(end_s * 20)):
        stamp = T0 + t * STEP // 2
        out.append(("/tf", TF, stamp + pose_delay_ns, {"transforms": [*tf_extra, transform(stamp, "map", "base", (SPEED * t * 0.05, 0, 0))]}))
    for k in range(n):
        for topic, frame in lidars:
            out.append((topic, CLOUD, T0 + k * STEP + cloud_delay_ns, cloud(T0 + k * STEP + ahead_ns, frame)))
    return sorted(out, key=lambda m: m[2])


def written(name, messages, **given):
    path = WORK / (name + ".mcap")
    bags.write_mcap(path, messages, **given)
    return path


def check(bag, *settings, n=N, most_m=1e-6, extra_m=0.0):
    """Checks all frames of a log with one LiDAR: its points, and its position along x.
    @param extra_m the position differs by this distance from the true one"""
    folder, head, notes = convert(bag, *settings)
    expect(len(head["frames"]) == n, f"{bag.name}: {len(head['frames'])} frames, expected {n}\n{notes}")
    rows = np.loadtxt(folder / "poses.txt", ndmin=2)
    for k, frame in enumerate(head["frames"]):
        scan = np.load(folder / frame["scan"])
        apart = np.linalg.norm(returns(scan)[0][:, None] - points()[None], axis=-1)
        expect(apart.shape == (ROWS * COLUMNS,) * 2 and max(apart.min(0).max(), apart.min(1).max()) < 1e-4, f"{bag.name}, frame {k}: points")
        apart = rows[k, 1] - SPEED * 0.1 * k - extra_m
        expect(abs(apart) <= most_m, f"{bag.name}, frame {k}: {apart} m beside its place\n{notes}")
    return notes


def test_clocks():
    delays = {"cloud_delay_ns": 112_000_000, "pose_delay_ns": 3_000_000}   # a cloud is recorded after its sweep
    for ahead_s, most_m in ((37, 1e-6), (-18, 1e-6), (19, 1e-6), (3600, 1e-6), (5.3, 1.2), (-2.7, 1.2), (500, 1.2), (-1_699_999_990, 1.2)):
        check(written("clocks", log(ahead_ns=round(ahead_s * SECOND), **delays)), most_m=most_m)
        notes = run("info", WORK / "clocks.mcap")
        number = f"{abs(ahead_s):.3f}" if most_m < 1 else ""
        expect(names(notes, f"{number} ... s {'ahead of' if ahead_s > 0 else 'behind'}"), f"{ahead_s} s: {notes}")
    # poses of a minute, so scans of another clock have poses, too
    for ahead_s in (37, -18):
        check(written("long", log(ahead_ns=ahead_s * SECOND, start_s=-60, end_s=60, **delays)))
    for delay_s in (0, 0.05, 0.4):   # these delays are normal
        notes = check(written("delays", log(cloud_delay_ns=round(delay_s * SECOND), pose_delay_ns=2_000_000)))
        expect("recording times" not in notes, f"a delay of {delay_s} s: {notes}")
    # ambiguous: 1.2 s may be a delay; poses with the stamps of the clouds may be 3 s late
    notes = check(written("unclear", log(ahead_ns=1_200_000_000, start_s=-3, end_s=3)), extra_m=12)
    expect(names(notes, "1.200 s ahead"), notes)
    late = check(written("late", log(n=40, pose_delay_ns=3_040_000_000)), n=40)
    expect(names(late, "3.0"), late)
    # recording times of a conversion: 1 ms from message to message, or a second log, days later
    plain = log(n=40)
    for name, messages in (("fast", [(*m[:2], T0 + i * 1_000_000, m[3]) for i, m in enumerate(plain)]),
                           ("sorted", [(*m[:2], T0 + i * 1_000_000, m[3]) for i, m in enumerate(sorted(plain, key=lambda m: m[0]))]),
                           ("short", [(*m[:2], T0, m[3]) for m in log(n=5, start_s=-9)]),
                           ("again", [(*m[:2], m[2] + 10**14, m[3]) for m in plain])):
        notes = check(written(name, messages), n=5 if name == "short" else 40)
        expect("recording times" not in notes, f"{name}: {notes}")


def with_clock(ahead_s, n=40, of=CLOUD, **given):
    """Returns a drive in which the clock of the LiDAR is ahead by ahead_s(sweep)."""
    messages = log(n, **given)
    for name, kind, _, message in messages:
        for header in [message["header"]] if kind == CLOUD == of else [t["header"] for t in message.get("transforms", ()) if name == "/tf" and of == TF]:
            header["stamp"] += round(ahead_s((header["stamp"] - T0) / STEP) * SECOND)
    return messages


def test_clock_jumps():
    delays = {"cloud_delay_ns": 112_000_000, "pose_delay_ns": 3_000_000, "start_s": -60, "end_s": 60}
    for before_s, after_s in ((0, 37), (37, 0), (0, -18), (5.3, 0), (-1_699_999_990, 0), (37, 18)):
        notes = check(written("jump", with_clock(lambda k: before_s if k < 15 else after_s, **delays)), n=40)
        expect(names(notes, f"jumps ... {abs(after_s - before_s):.3f} s"), notes)
    late = lambda k: 3_000_000_000 if 10 <= k < 20 else 0   # a queue is recorded late
    queue = [(*m[:2], m[2] + (late((m[2] - T0) / STEP) if m[1] == CLOUD else 0), m[3]) for m in log(40)]
    for n, messages in ((40, queue), (30, [m for m in queue if m[1] != CLOUD or not T0 + 20 * STEP <= m[2] < T0 + 30 * STEP])):
        expect(not any(text in convert(written("queue", sorted(messages, key=lambda m: m[2])))[2] for text in ("left out", "corrected")), "a late queue")
    both = [m for m in with_clock(lambda k: 0 if k < 15 else 37) if m[1] != TF or m[0] != "/tf"]
    both += [m for m in with_clock(lambda k: 0 if k < 15 else 37, of=TF) if m[0] == "/tf"]
    expect("corrected" not in convert(written("both", sorted(both, key=lambda m: m[2])))[2], "poses jump, too")


def test_damaged_times():
    for bad, stamp, recorded in ((5, 10**17 + T0, None), (0, 10**17 + T0, None), (39, T0 - 10**11, None), (5, 0, None), (5, None, 4_294_000_000 * SECOND)):
        messages = log(40)
        for i, m in enumerate(messages):
            if m[1] != CLOUD:
                continue
            k = (m[2] - T0) // STEP
            m[3]["header"]["stamp"] = (stamp if k == bad else m[2]) if recorded is None else 0
            messages[i] = (*m[:2], recorded if recorded and k == bad else m[2], m[3])
        folder, _, notes = convert(written("damaged", messages))
        rows = np.loadtxt(folder / "poses.txt")
        true = [SPEED * 0.1 * k for k in range(40) if k != bad]
        expect(rows.shape[0] == 39 and np.abs(rows[:, 1] - true).max() < 1e-5 and "1 clouds" in notes, f"cloud {bad}: {rows[:, :2]}\n{notes}")


def test_small_offsets():
    for ahead_s in (0.3, 0.5):
        for delay_s in (0, 0.11):
            notes = convert(written("small", log(40, ahead_ns=round(ahead_s * SECOND), cloud_delay_ns=round(delay_s * SECOND))))[2]
            expect(names(notes, "s ahead of"), f"{ahead_s} s: {notes}")
    for per_sweep_s in (0.01, 0.04, -0.04):   # 0.9 of the change is seen between the tenths
        notes = convert(written("drift", with_clock(lambda k: k * per_sweep_s, start_s=-5, end_s=5)))[2]
        expect(names(notes, f"{0.9 * 40 * abs(per_sweep_s):.3f} s"), notes)


def test_half_a_sweep():
    front, rear = log(60), [(*m[:2], m[2] + STEP // 2, m[3]) for m in log(60, ahead_ns=STEP // 2, lidars=(("/rear", "rear"),))]
    _, head, notes = convert(written("half", sorted(front + [m for m in rear if m[0] == "/rear"], key=lambda m: m[2])))
    expect([f["lidar"] for f in head["frames"]] == ["/points", "/rear"] * 60 and "near their times" not in notes, notes)


def test_late_scans():
    """The times of most points of some scans are wrong. These scans are skipped."""
    for late, late_s in (([7], lambda t: 3), ([6], lambda t: 0.5), ([35, 36, 37, 38, 39], lambda t: 3), ([7], lambda t: 37),
                         ([7], lambda t: 3 * (t > 0.03))):
        messages = [(*m[:3], cloud(m[2], late_s=late_s)) if m[1] == CLOUD and (m[2] - T0) // STEP in late else m for m in log(n=40)]
        folder, head, notes = convert(written("late_scans", messages))
        expect([f["number"] for f in head["frames"]] == [k for k in range(40) if k not in late], f"{late}: {head['frames']}\n{notes}")
        expect(notes.count("scan that cannot be read is skipped") == len(late), f"{late}: {notes}")
        expect(max(np.load(folder / f["scan"])["time"].max() for f in head["frames"]) < 0.1, f"{late}: times")


def test_times_of_clocks():
    """Times are on a clock that begins again. Offsets from the stamp that are 0.9 s late are no such times."""
    for period_s in (1, 60, 86400):
        late = lambda k: lambda t: np.mod(k * 0.1 + t.astype("f8") + period_s - 0.55, period_s) - t
        messages = [(*m[:3], cloud(m[2], late_s=late((m[2] - T0) // STEP), kind="f8")) if m[1] == CLOUD else m for m in log(n=40)]
        folder, head, notes = convert(written("clock_times", messages))
        expect(len(head["frames"]) == 40 and "skipped" not in notes, f"{period_s} s: {notes}")
        for f in head["frames"]:
            t = np.load(folder / f["scan"])["time"]
            expect(abs(t - np.arange(COLUMNS) * 0.1 / COLUMNS).max() < 1e-3, f"{period_s} s, {f}: {t}\n{notes}")
    messages = [(*m[:3], cloud(m[2], late_s=lambda t: 0.9 * (t > 0.09))) if m[1] == CLOUD and m[2] == T0 + 7 * STEP else m for m in log(n=40)]
    notes = convert(written("nearly_a_second", messages))[2]
    expect(names(notes, f"{8 * ROWS} points of 1"), notes)


def test_clocks_of_lidars():
    """The rear LiDAR has the time of GPS, the front LiDAR has UTC. Both measure simultaneously."""
    front, rear = log(), log(ahead_ns=18 * SECOND, lidars=(("/rear", "rear"),))
    folder, head, notes = convert(written("two_clocks", sorted(front + [m for m in rear if m[0] == "/rear"], key=lambda m: m[2])))
    expect([f["lidar"] for f in head["frames"]] == ["/points", "/rear"] * N, f"frames {head['frames']}\n{notes}")
    expect(names(notes, "/rear ... 18.000 s ahead"), notes)
    for a, b in zip(head["frames"][::2], head["frames"][1::2]):
        times = [np.load(folder / f["scan"])["time"].min() + f["time_s"] for f in (a, b)]
        expect(abs(times[0] - times[1]) < 1e-6, f"frames {a} and {b}: times {times}")


def test_pose_files():
    """Poses as text on the clock of the recorder, scans 37 s ahead."""
    bag = written("text", [m for m in log(ahead_ns=37 * SECOND) if m[0] != "/tf"])
    for first_s, last_s, extra_m, text in ((-1, 3, 0, "37.000 s ahead ... only on the latter"), (-1, 60, 370, "37.000 s ahead ... both clocks")):
        t = np.arange(first_s, last_s, 0.05)
        rows = "".join(f"{T0 // SECOND + s:.3f} {SPEED * s:.6f} 0 0 1 0 0 0\n" for s in t)
        (WORK / "poses.txt").write_text("# time_s x y z qw qx qy qz\n" + rows)
        notes = check(bag, f"dataset.poses={WORK / 'poses.txt'}", most_m=1e-5, extra_m=extra_m)
        expect(names(notes, text), notes)
    (WORK / "poses.txt").write_text("".join(f"1 0 0 {k} 0 1 0 0 0 0 1 0\n" for k in range(N)))
    expect("37.000" not in check(bag, f"dataset.poses={WORK / 'poses.txt'}"), "matrices have no clock")
    # Without recording times of another clock, the error names the likely cause.
    (WORK / "poses.txt").write_text("# time_s x y z qw qx qy qz\n" + "".join(f"{T0 // SECOND + 18 + s:.3f} {s} 0 0 1 0 0 0\n" for s in range(-1, 3)))
    expect("GPS" in run("info", written("gps", log()), "--set", f"dataset.poses={WORK / 'poses.txt'}", code=3), "poses on the clock of GPS")
    (WORK / "poses.txt").write_text("".join(f"{T0 // SECOND + 3600 + s:.3f} {s} 0 0 1 0 0 0\n" for s in range(-1, 3)))
    hour = run("info", written("hour", log()), "--set", f"dataset.poses={WORK / 'poses.txt'}", code=3)
    expect("sequence.json" not in hour and names(hour, "conventions.clock_offset_s ... -3599.000"), hour)


def test_transforms():
    for q in ((0, 0, 0, 0), (0, 0, 0, math.nan), (0, 0, 0, 2)):
        notes = check(written("tf", log(tf_extra=[transform(T0, "earth", "enu", (0, 0, 0), quaternion=q)])))
        expect(names(notes, "44 poses ... 'earth' ... 'enu'"), notes)
    messages = log()
    messages[0][3]["transforms"].insert(0, transform(T0, "base", "camera", (math.nan, 0, 0)))
    expect("1 poses" in check(written("static", messages)), "a bad static transform")
    odometry = [("/pose", "geometry_msgs/PoseStamped", m[2], {"header": m[3]["transforms"][0]["header"], "pose": m[3]["transforms"][0]["transform"]})
                if m[0] == "/tf" else m for m in log()]
    odometry[0][3]["pose"] = dict(odometry[0][3]["pose"], orientation=dict(x=0, y=0, z=0, w=0))
    expect("1 poses" in check(written("poses", odometry), extra_m=0), "a bad pose message")


def test_recording_times():
    bad = log()
    bad.insert(9, ("/note", "std_msgs/String", 2**64 - 90_000_000, {"data": "x"}))
    expect("recording time" not in check(written("unused", bad, chunk=4)), "the time of an unused topic")
    bad[9] = (*bad[9][:2], -90_000_000, bad[9][3])
    bags.write_db3(WORK / "unused.db3", bad)
    expect("recording time" not in check(WORK / "unused.db3"), "the time of an unused topic, db3")
    bad[8] = (*bad[8][:2], -90_000_000, bad[8][3])
    bags.write_db3(WORK / "used.db3", bad)
    expect(names(check(WORK / "used.db3"), f"{bad[8][0]} ... -90000000 ns"), "the time of a used topic")


def test_shared_frames():
    bag = written("one_frame", log(lidars=[("/points", "lidar"), ("/rear/points", "lidar"), ("/third", "lidar")]))
    expect(names(run("info", bag, code=2), "/points, /rear/points, /third ... 'lidar' ... dataset.lidars"), "topics of one frame")
    _, head, notes = convert(bag, "dataset.lidars=/points,/rear/points")
    expect([l["name"] for l in head["lidars"]] == ["/points", "/rear/points"] and "not read" not in notes, notes)
    # clouds without times of points, such as filtered ones, come after those with times
    filtered = [("/filtered", CLOUD, m[2], dict(m[3], fields=m[3]["fields"][:4])) for m in log() if m[1] == CLOUD]
    notes = check(written("filtered", sorted(log() + filtered, key=lambda m: m[2])))
    expect(names(notes, "not read: /filtered ... /points ... 'lidar'"), notes)
    # the kind of poses decides, then the user
    odometry = [(f"/{name}", "geometry_msgs/PoseStamped", m[2], {"header": m[3]["transforms"][0]["header"], "pose": m[3]["transforms"][0]["transform"]})
                for m in log() if m[0] == "/tf" for name in "ab"]
    bag = written("two_poses", [m for m in log() if m[1] != TF] + odometry)
    expect(names(run("info", bag, code=2), "/a, /b ... poses ... dataset.poses_from=/a"), "two topics of poses")
    check(bag, "dataset.poses_from=/b")
    convert(bag, "dataset.poses=none")


def test_shared_topics():
    livox = []
    sectors = np.arange(COLUMNS).reshape(5, 18)
    for k in range(N):
        for number, columns in enumerate(sectors):
            data = [{"offset_time": 1000 * i, **dict(zip("xyz", p)), "reflectivity": i % 200, "tag": 0, "line": i % 4}
                    for i, p in enumerate(points(columns))]
            stamp = T0 + k * STEP
            livox.append(("/livox", LIVOX, stamp + number, {"header": {"stamp": stamp, "frame_id": "lidar"}, "timebase": stamp,
                                                            "point_num": len(data), "lidar_id": 40 + number, "rsvd": (0, 0, 0), "points": data}))
    bag = written("livox", sorted(livox + [m for m in log() if m[1] == TF], key=lambda m: m[2]))
    folder, head, notes = convert(bag)
    expect([l["name"] for l in head["lidars"]] == [f"/livox:{40 + i}" for i in range(5)], f"{head['lidars']}\n{notes}")
    expect(len(head["frames"]) == 5 * N and names(notes, "/livox ... 5 LiDARs"), notes)
    for i, frame in enumerate(head["frames"]):
        scan = np.load(folder / frame["scan"])
        expect(np.abs(returns(scan)[0] - points(sectors[i % 5])).max() < 1e-4, f"points of {frame}")
    for chosen, n in (("/livox", 5), ("/livox:42", 1)):
        expect(len(convert(bag, f"dataset.lidars={chosen}")[1]["lidars"]) == n, f"dataset.lidars={chosen}")
    # clouds that take turns in two frames, with their mountings in /tf_static
    front, rear = log(), log(lidars=(("/points", "rear"),))
    _, head, notes = convert(written("turns", sorted(front + [m for m in rear if m[1] == CLOUD], key=lambda m: m[2])))
    mounts = {l["name"]: l["vehicle_from_sensor"]["translation"] for l in head["lidars"]}
    expect(mounts == {"/points:lidar": [0, 0, 1.8], "/points:rear": [-2, 0, 1.8]} and len(head["frames"]) == 2 * N, f"{mounts}\n{notes}")
    # one stray cloud is no LiDAR
    notes = check(written("stray", [(*m[:3], dict(m[3], header={"stamp": m[3]["header"]["stamp"], "frame_id": "odd"})) if m[0] == "/points" and
                                    m[2] == T0 + 5 * STEP else m for m in log()]))
    expect(names(notes, "1 clouds ... 'odd'"), notes)


def test_conventions():
    """Inverse transforms above a mounting, and an unclear clock: right only with the setting."""
    messages = log()
    for topic, _, _, body in messages:
        if topic == "/tf":
            place = body["transforms"][0]["transform"]["position"]
            place["x"] = -place["x"]
    bag = written("inverse", messages)
    check(bag, "conventions.poses=sensor_from_world")
    heights = np.loadtxt(WORK / "inverse.mcap.log" / "poses.txt")[:, 3]
    expect(np.abs(heights - 1.8).max() < 1e-6, f"heights {heights}, expected that of the mounting")
    expect(names(run("info", bag, "--set", "conventions.poses=sensor_from_world"), "poses ... sensor from world ... setting"), "the table")
    unclear = written("unclear", log(ahead_ns=1_200_000_000, start_s=-3, end_s=3))
    check(unclear, "conventions.clock_offset_s=1.2")
    expect(names(run("info", unclear, "--set", "conventions.clock_offset_s=1000", code=3), "no ... pose"), "a wrong offset")


def test_split():
    """The second part of a split bag has no /tf_static. The poses in /tf then count for the LiDAR."""
    wheels = lambda stamp, t: [transform(stamp, "base", f"wheel_{i}", (0, 0, 0), t) for i in range(2)]
    messages = [m for m in log() if m[0] != "/tf_static"]
    for name, extra in (("split", lambda stamp, t: []), ("wheels", wheels)):
        part = [(*m[:3], {"transforms": m[3]["transforms"] + extra(m[2], i)}) if m[1] == TF else m for i, m in enumerate(messages)]
        notes = check(written(name, part))
        expect(names(notes, "'lidar' ... 'base' ... /tf ... /tf_static ... first part"), notes)
        rows = np.loadtxt(WORK / f"{name}.mcap.log/poses.txt")
        expect(np.abs(rows[:, 2:] - [0, 0, 1, 0, 0, 0]).max() < 1e-6, f"{name}: {rows}")
    other = [(*m[:3], {"transforms": m[3]["transforms"] + [transform(m[2], "map", "other", (-0.5 * i, 0, 0))]}) if m[1] == TF else m
             for i, m in enumerate(messages)]
    _, head, notes = convert(written("unclear_vehicle", other))
    expect(names(notes, "base, other ... not used ... 'lidar'"), notes)


def with_clouds(change):
    """Returns a drive with change(cloud message, stamp) for each cloud."""
    return [(*m[:3], change(m[3], m[2])) if m[1] == CLOUD else m for m in log()]


def test_row_steps():
    """Without padding, the number of points is known, whatever row_step says."""
    for row_step in (0, 1, ROWS * COLUMNS * 18, 2**32 - 1):
        check(written("row_step", with_clouds(lambda c, _: dict(c, height=COLUMNS, width=ROWS, row_step=row_step))))
    short = with_clouds(lambda c, _: dict(c, height=COLUMNS, width=ROWS, row_step=999, data=c["data"][:-1]))
    expect(names(run("info", written("short", short), code=3), f"{COLUMNS * ROWS * 18 - 1} bytes ... {COLUMNS} rows of 999 bytes"), "missing bytes")


def test_wide_integers():
    """Times are nanoseconds in 64-bit integers, which PointField.msg does not define but PCL writes."""
    for kind in ("i8", "u8"):
        def change(_, stamp):
            p = points()
            row = np.zeros(len(p), [("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2"), ("timestamp", kind)])
            row["x"], row["y"], row["z"] = p.T
            row["ring"], row["timestamp"] = np.arange(len(p)) % ROWS, stamp + np.arange(len(p)) // ROWS * (STEP // COLUMNS)
            return cloud_of_rows(stamp, "lidar", row)
        bag = written("wide", with_clouds(change))
        check(bag)
        for k in range(N):
            t = np.load(WORK / f"{bag.name}.log/scans/{k:06}.npz")["time"]
            expect(np.abs(t - np.arange(COLUMNS) * 0.1 / COLUMNS).max() < 2e-6, f"{kind}: {t[0]}")


def test_unknown_intensities():
    values = np.where(np.arange(ROWS * COLUMNS) % 50 == 7, np.nan, np.arange(ROWS * COLUMNS) % 256)

    def change(_, stamp):
        p = points()
        row = np.zeros(len(p), [("x", "f4"), ("y", "f4"), ("z", "f4"), ("ring", "u2"), ("intensity", "f4")])
        row["x"], row["y"], row["z"] = p.T
        row["ring"], row["intensity"] = np.arange(len(p)) % ROWS, values
        return cloud_of_rows(stamp, "lidar", row)
    notes = check(written("nan", with_clouds(change)))
    expect(names(notes, f"{6 * np.isnan(values).sum()} of {6 * len(values)} intensities ... 0"), notes)
    scan = np.load(WORK / "nan.mcap.log/scans/000000.npz")
    found, hit = returns(scan)
    nearest = np.linalg.norm(found[:, None] - points()[None], axis=-1).argmin(1)
    expect(np.abs(scan["intensity"][hit] - np.nan_to_num(values)[nearest] / 255).max() < 1e-6, "intensities")


def test_paths():
    """A path repeats its poses. A loop closure moves them in the last message."""
    poses = [m[3]["transforms"][0] for m in log() if m[0] == "/tf"]

    def path(first, end, late_m=0.0):
        placed = [{"header": p["header"], "pose": dict(p["transform"], position=dict(p["transform"]["position"], y=late_m))} for p in poses[first:end]]
        stamp = placed[-1]["header"]["stamp"]
        return ("/path", "nav_msgs/Path", stamp, {"header": placed[-1]["header"], "poses": placed})

    clouds = [m for m in log() if m[1] == CLOUD]
    n = len(poses)
    for name, paths in (("growing", [path(0, i, late_m=5.0 * (i < n)) for i in range(1, n + 1)]),
                        ("window", [path(max(0, i - 5), i) for i in range(1, n + 1)]), ("once", [path(0, n)])):
        bag = written(name, sorted(clouds + paths, key=lambda m: m[2]))
        notes = check(bag)
        expect("/path" in notes and np.abs(np.loadtxt(WORK / f"{bag.name}.log/poses.txt")[:, 2]).max() < 1e-6, f"{name}: {notes}")
    for p in poses:
        p["header"] = dict(p["header"], stamp=0)
    notes = convert(written("no_stamps", clouds + [(*path(0, n)[:2], T0 + STEP, path(0, n)[3])]))[2]
    expect(names(notes, f"{n} poses ... time stamp") and "has no poses" in notes, notes)


def test_unused_topics():
    """Messages of unused topics are not read. With an index, this also holds for chunks."""
    size, images = 4_000_000, 8
    messages = log()
    messages += [("/camera", "sensor_msgs/CompressedImage", T0 + i * STEP + 1, {"header": {"stamp": 0, "frame_id": ""}, "format": "", "data": bytes(size)})
                 for i in range(images)]
    messages.sort(key=lambda m: m[2])
    alone = sorted(messages, key=lambda m: m[0] == "/camera")   # in their own chunks
    first = sorted(messages, key=lambda m: m[0] != "/camera")
    for name, write in (("plain.mcap", lambda path: bags.write_mcap(path, messages)), ("table.db3", lambda path: bags.write_db3(path, messages)),
                        ("last.mcap", lambda path: bags.write_mcap(path, alone, chunk=len(alone) - images, index=True)),
                        ("first.mcap", lambda path: bags.write_mcap(path, first, chunk=images, index=True)),
                        ("first.bag", lambda path: bags.write_ros1(path, first, chunk=images, index=True))):
        write(WORK / name)
        notes = check(WORK / name)
        expect(names(notes, f"/camera ... {images} messages"), f"{name}: {notes}")
        process = subprocess.Popen([RELIDAR, "info", WORK / name], stdout=subprocess.DEVNULL)
        os.waitid(os.P_PID, process.pid, os.WEXITED | os.WNOWAIT)
        n_read = int(pathlib.Path(f"/proc/{process.pid}/io").read_text().split()[1])
        expect(process.wait() == 0 and n_read < size, f"{name}: {n_read} bytes were read")


def squeezed(program, data):
    return subprocess.run([program, "-c", "-q"], input=data, capture_output=True, check=True).stdout


def test_zstd():
    """rosbag2 compresses messages or files. The reader does not need metadata.yaml."""
    messages = log()
    folder = WORK / "messages"
    folder.mkdir()
    bags.write_db3(folder / "bag_0.db3", messages, compressed=True)
    check(folder)
    bags.write_metadata(folder, ["bag_0.db3"], "MESSAGE")
    check(folder)
    keep = bags.message_bytes   # messages of two frames of unknown size, as a stream writes them
    bags.message_bytes = lambda *given: squeezed("zstd", keep(*given)[:50]) + squeezed("zstd", keep(*given)[50:])
    for ending, write in (("db3", bags.write_db3), ("mcap", bags.write_mcap)):
        write(WORK / f"stream.{ending}", messages)
        check(WORK / f"stream.{ending}")
    bags.message_bytes = keep
    for ending, write in (("db3", bags.write_db3), ("mcap", bags.write_mcap)):
        folder = WORK / f"file_{ending}"
        folder.mkdir()
        write(folder / f"bag_0.{ending}", messages)
        packed = folder / f"bag_0.{ending}.zstd"
        packed.write_bytes(squeezed("zstd", (folder / f"bag_0.{ending}").read_bytes()))
        check(folder)   # both copies are one recording
        (folder / f"bag_0.{ending}").unlink()
        check(folder)
        check(packed)
        bags.write_metadata(folder, [f"bag_0.{ending}"], "FILE")
        check(folder)
        packed.write_bytes(packed.read_bytes()[:-20])
        expect("truncated" in run("info", folder, code=0 if ending == "mcap" else 3), f"a truncated {ending}.zstd")


def test_frames_of_chunks():
    """Compressed chunks may consist of several frames, and of frames that decoders skip."""
    skipped = struct.pack("<II", 0x184D2A53, 5) + b"12345"
    halves = lambda program, data: squeezed(program, data[:len(data) // 3]) + skipped + squeezed(program, data[len(data) // 3:]) + skipped
    packed, bags.packed = bags.packed, halves
    for compression in ("lz4", "zstd"):
        check(written(f"frames_{compression}", log(), compression=compression, chunk=6))
    bags.write_ros1(WORK / "frames.bag", log(), "lz4")
    check(WORK / "frames.bag")
    bags.packed = lambda program, data: squeezed(program, data) + squeezed(program, b"more")
    expect("damaged" in run("info", written("more", log(), compression="lz4", chunk=6), code=3), "more bytes than the chunk has")
    bags.packed = packed


run_tests(test_clocks, test_clock_jumps, test_damaged_times, test_small_offsets, test_half_a_sweep, test_late_scans, test_times_of_clocks,
          test_clocks_of_lidars, test_pose_files, test_transforms, test_recording_times, test_shared_frames, test_shared_topics, test_zstd,
          test_frames_of_chunks, test_split, test_conventions, test_row_steps, test_wide_integers, test_unknown_intensities, test_paths, test_unused_topics, programs=("lz4", "zstd"))
