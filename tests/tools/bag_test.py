# SPDX-License-Identifier: Apache-2.0
"""Tests ROS bags of every type, written by bag_writer.py. A LiDAR of 16 beams measures a round hall
from a car in a bend. The points have the layouts of the drivers of several manufacturers. relidar
reads each bag and writes it as npz and text. Both must contain the same points, times, rings and
poses.

   bag_test.py RELIDAR WORK        77: numpy, lz4 or zstd are missing
"""
from bag_harness import TYPE_CODES, WORK, convert, expect, np, pose, returns, run, run_tests, transform, turned

import bag_writer as bags
from names import names

T0, STEP, N, COLUMNS = 1_700_000_000_250_000_000, 100_000_000, 5, 360
ELEVATIONS = np.radians(np.linspace(15, -15, 16))
# position in base_link; the LiDAR is also turned by 90 degrees to the left
MOUNT = np.array([0.8, 0.0, 1.7])
RADIUS, HEIGHT = 22.0, 7.0


def car(t_s):
    """Returns the pose of base_link in the map at a time in seconds after T0."""
    t = np.asarray(t_s, float)
    return np.stack([3 + 8 * t, 2 + 1 * t, 0 * t], -1), 0.2 + 0.3 * t


def lidar(t_s, mount=MOUNT, yaw=np.pi / 2):
    place, heading = car(t_s)
    return place + turned(np.broadcast_to(mount, place.shape), heading), heading + yaw


def sweep(k, offset_ns=0, mount=MOUNT, yaw=np.pi / 2):
    """Returns points [rings, columns, 3] in the sensor's frame at their times, and the times in ns
    from T0. The sweep is clockwise and starts backward. NaN means no return."""
    start = k * STEP + offset_ns
    t_ns = start + np.arange(COLUMNS) * (STEP // COLUMNS)
    azimuth = np.pi - 2 * np.pi * np.arange(COLUMNS) / COLUMNS
    d = np.stack([np.cos(ELEVATIONS)[:, None] * np.cos(azimuth), np.cos(ELEVATIONS)[:, None] * np.sin(azimuth),
                  np.sin(ELEVATIONS)[:, None] + 0 * azimuth], -1)
    place, heading = lidar(t_ns * 1e-9, mount, yaw)
    w = turned(d, heading)
    b = (w[..., :2] * place[:, :2]).sum(-1)
    a = (w[..., :2] ** 2).sum(-1)
    wall = (-b + np.sqrt(b * b - a * ((place[:, :2] ** 2).sum(-1) - RADIUS**2))) / a
    with np.errstate(divide="ignore"):
        flat = np.where(w[..., 2] > 0, (HEIGHT - place[:, 2]) / w[..., 2], place[:, 2] / -w[..., 2])
    points = (d * np.minimum(wall, flat)[..., None]).astype("f4")
    points[5, 40:60] = np.nan   # rays through a window have no return
    intensity = (10 + 5 * np.arange(16)[:, None] + np.arange(COLUMNS) % 90).astype("f4")
    return points, np.broadcast_to(t_ns, (16, COLUMNS)), intensity


def cloud(stamp_ns, frame, columns, step, organised=False, big=False, row_pad=0):
    """Writes a cloud. Organised clouds keep dropped points as zeros.
    @param columns name, type, offset and values [rings, columns] of each field"""
    x = columns[0][3]
    keep = np.isfinite(x)
    shape = x.shape if organised else (1, int(keep.sum()))
    data = np.zeros((shape[0], shape[1] * step + row_pad), "u1")
    for name, code, offset, values in columns:
        v = np.where(keep, values, 0) if organised else np.asarray(values)[keep].reshape(shape)
        raw = np.ascontiguousarray(v.astype((">" if big else "<") + code)).view("u1").reshape(shape[0], shape[1], -1)
        for i in range(raw.shape[2]):
            data[:, offset + i:shape[1] * step:step] = raw[:, :, i]
    return {"header": {"stamp": stamp_ns, "frame_id": frame}, "height": shape[0], "width": shape[1],
            "fields": [{"name": n, "offset": o, "datatype": TYPE_CODES[c], "count": 1} for n, c, o, _ in columns],
            "is_bigendian": int(big), "point_step": step, "row_step": data.shape[1], "data": data.tobytes(), "is_dense": int(not organised)}


RINGS = np.broadcast_to(np.arange(16)[:, None], (16, COLUMNS))


def xyz(p, order=(0, 4, 8), code="f4"):
    return [("xyz"[i], code, order[i], p[..., i]) for i in range(3)]


# the stamp is the time of the last point, so point times increase to 0
def velodyne(k, frame="lidar", **sensor):
    p, t, i = sweep(k, **sensor)
    stamp = t[0, -1]
    return T0 + int(stamp), cloud(T0 + int(stamp), frame, xyz(p) + [("intensity", "f4", 12, i), ("ring", "u2", 16, 15 - RINGS),
                                                                   ("time", "f4", 18, (t - stamp) * 1e-9)], 22)


def ouster(k, frame="lidar"):
    p, t, i = sweep(k)
    stamp = t[0, 0]
    return T0 + int(stamp), cloud(T0 + int(stamp), frame, xyz(p) + [
        ("intensity", "f4", 16, i), ("t", "u4", 20, t - stamp), ("reflectivity", "u2", 24, 7 + 0 * i), ("ring", "u2", 26, RINGS),
        ("ambient", "u2", 28, 0 * i), ("range", "u4", 32, 1000 + 0 * i)], 48, organised=True, row_pad=16)


def hesai(k, frame="lidar", big=False):
    p, t, i = sweep(k)
    stamp = t[0, 0]
    return T0 + int(stamp), cloud(T0 + int(stamp), frame, [xyz(p, (4, 8, 0))[j] for j in (2, 0, 1)] + [
        ("intensity", "u1", 12, i), ("timestamp", "f8", 16, (T0 + t) * 1e-9), ("ring", "u2", 24, RINGS)], 26, big=big)


# every seventh ray has a second return 1.5 m behind the strongest return, stored before
# it
def autoware(k, frame="lidar"):
    p, t, i = sweep(k)
    both = lambda v, w: np.concatenate([np.asarray(w)[:, ::7], v], 1)
    r = np.linalg.norm(p, axis=-1, keepdims=True)
    far = (p * (r + 1.5) / r).astype("f4")
    stamp = t[0, 0]
    strong = both(np.full(i.shape, 3), np.full(i.shape, 1))
    return T0 + int(stamp), cloud(T0 + int(stamp), frame, [("xyz"[a], "f4", 4 * a, both(p[..., a], far[..., a])) for a in range(3)] + [
        ("intensity", "u1", 12, both(i, i / 2)), ("return_type", "u1", 13, strong), ("channel", "u2", 14, both(RINGS, RINGS)),
        ("azimuth", "f4", 16, 0 * both(i, i)), ("elevation", "f4", 20, 0 * both(i, i)), ("distance", "f4", 24, 0 * both(i, i)),
        ("time_stamp", "u4", 28, both(t - stamp, t - stamp))], 32)


def poses(kind, frame="lidar", slash=""):
    """Returns poses every 20 ms from 0.1 s before the first sweep to 0.2 s after the last sweep."""
    tf = "tf/tfMessage" if slash else "tf2_msgs/TFMessage"
    static = [transform(0, "base_link", frame, MOUNT, np.pi / 2), transform(0, "base_link", "camera", MOUNT, 0.3)]
    out = [("/tf_static", tf, T0 - STEP, {"transforms": static})]
    for ns in range(-STEP, (N + 2) * STEP, 20_000_000):
        place, yaw = car(ns * 1e-9)
        stamp = T0 + ns
        # map -> odom has a constant rotation and shift, which odom -> base_link
        # compensates
        if kind == "tf":
            local = turned(place - np.array([1.0, 2.0, 0.0]), -0.1)
            value = [transform(stamp, slash + "odom", slash + "base_link", local, yaw - 0.1)]
            out.append(("/tf", tf, stamp, {"transforms": value}))
            out.append(("/tf", tf, stamp, {"transforms": [transform(stamp, slash + "map", slash + "odom", [1.0, 2.0, 0.0], 0.1)]}))
        elif kind == "odometry":
            twist = {"linear": dict(x=0.0, y=0.0, z=0.0), "angular": dict(x=0.0, y=0.0, z=0.0)}
            out.append(("/odometry", "nav_msgs/Odometry", stamp, {
                "header": {"stamp": stamp, "frame_id": "odom"}, "child_frame_id": "base_link",
                "pose": {"pose": pose(place, yaw), "covariance": [0.0] * 36}, "twist": {"twist": twist, "covariance": [0.0] * 36}}))
        elif kind == "pose":
            out.append(("/localization", "geometry_msgs/PoseStamped", stamp, {"header": {"stamp": stamp, "frame_id": "map"},
                                                                               "pose": pose(place, yaw)}))
    return out


def log(driver, kind="tf", topic="/points", slash="", **given):
    messages = poses(kind, slash=slash)
    for k in range(N):
        stamp, value = driver(k, **given)
        messages.append((topic, "sensor_msgs/PointCloud2", stamp + 5_000_000, value))
        messages.append(("/chatter", "std_msgs/String", stamp + 6_000_000, {"data": "hello"}))
    return sorted(messages, key=lambda m: m[2])


def check(name, bag, *settings, second=False, stamps="first", poses_there=True):
    folder, head, _ = convert(bag, *settings)
    frames = head["frames"]
    expect([f["number"] for f in frames] == list(range(N)), f"{name}: frames {[f['number'] for f in frames]}, expected {N}")
    rows = np.loadtxt(folder / "poses.txt", ndmin=2) if poses_there else None
    zero_ns = T0 + (int(sweep(0)[1][0, -1]) if stamps == "last" else 0)
    for k, frame in enumerate(frames):
        scan = np.load(folder / frame["scan"])
        found, hit = returns(scan)
        p, t, i = sweep(k)
        keep = np.isfinite(p[..., 0])
        truth = p[keep]
        expect(len(found) == len(truth), f"{name}, frame {k}: {len(found)} points, expected {len(truth)}")
        key = lambda v: np.round(np.degrees(np.arctan2(v[:, 1], v[:, 0]))).astype(int) % 360 * 100 + np.round(
            np.degrees(np.arctan2(v[:, 2], np.hypot(v[:, 0], v[:, 1]))) / 2 + 7.5).astype(int)
        a, b = np.argsort(key(found)), np.argsort(key(truth))
        apart = np.abs(found[a] - truth[b]).max()
        expect(apart < 2e-4, f"{name}, frame {k}: points {apart} m apart")
        time = scan["time"][hit][a] + frame["time_s"] + 1e-9 * (zero_ns - T0)
        apart = np.abs(time - 1e-9 * t[keep][b]).max()
        expect(apart < 1e-6, f"{name}, frame {k}: times {apart} s apart")
        expect(np.abs(scan["intensity"][hit][a] - i[keep][b] / 255).max() < 1e-6, f"{name}, frame {k}: intensities differ")
        expect((scan["ring"][hit][a] == RINGS[keep][b]).all(), f"{name}, frame {k}: rings differ")
        expect(scan["range"].shape == (16, COLUMNS), f"{name}, frame {k}: an image of {scan['range'].shape}")
        if second:
            far = scan["range_2"][hit][a]
            wanted = (np.arange(COLUMNS) % 7 == 0)[None, :] & keep
            expect(np.abs(far - np.where(wanted[keep][b], scan["range"][hit][a] + 1.5, 0)).max() < 1e-4, f"{name}, frame {k}: second returns")
        if rows is not None:
            place, yaw = lidar(1e-9 * (zero_ns - T0) + frame["time_s"])
            expect(abs(rows[k, 0] - frame["time_s"]) < 1e-9 and np.abs(rows[k, 1:4] - place).max() < 1e-6, f"{name}, frame {k}: position {rows[k]}")
            expect(np.abs(rows[k, 4:] - [np.cos(yaw / 2), 0, 0, np.sin(yaw / 2)]).max() < 1e-7, f"{name}, frame {k}: heading {rows[k]}")
    return head


def test_mcap():
    bag = WORK / "velodyne.mcap"
    bags.write_mcap(bag, log(velodyne), compression="zstd", chunk=7)
    check("MCAP, zstd, Velodyne, /tf", bag, stamps="last")
    notes = run("info", bag)
    for text in ("topic /points: sensor_msgs/PointCloud2, 5 messages", "frame 'lidar'", "ring U16", "/chatter", "'map' ... /tf", ": used",
                 "of point times ... s ... 0 at the stamp"):
        expect(names(notes, text), f"info does not say '{text}':\n{notes}")
    bag = WORK / "ouster.mcap"
    bags.write_mcap(bag, log(ouster, "odometry"), compression="lz4", chunk=3, end=False)
    check("MCAP, lz4, Ouster organised, Odometry", bag)
    bag = WORK / "hesai.mcap"
    bags.write_mcap(bag, log(hesai, "pose", big=True), form="cdr_be")
    check("MCAP without chunks, big-endian, Hesai, PoseStamped", bag)


def test_db3():
    bag = WORK / "autoware"
    bag.mkdir()
    messages = log(autoware)
    half = len(messages) // 2
    bags.write_db3(bag / "part_b.db3", messages[half:])
    bags.write_db3(bag / "part_c.db3", messages[:half])
    bags.write_metadata(bag, ["part_c.db3", "part_b.db3"])
    check("split db3, Autoware with second returns", bag, second=True)


def test_ros1():
    for compression in ("none", "bz2", "lz4"):
        bag = WORK / f"velodyne_{compression}.bag"
        bags.write_ros1(bag, log(velodyne, slash="/"), compression)
        check(f"ROS 1, {compression}, Velodyne, frames with a slash", bag, stamps="last")


def test_ends():
    """Reads a bag after a simulated crash. The complete chunks before the crash must form the log."""
    for name, writer in (("cut.mcap", lambda path, m: bags.write_mcap(path, m, compression="zstd", chunk=10)),
                         ("cut.bag", lambda path, m: bags.write_ros1(path, m, "bz2", chunk=10))):
        bag = WORK / name
        writer(bag, log(hesai))
        bag.write_bytes(bag.read_bytes()[:int(0.8 * bag.stat().st_size)])
        text = run("info", bag)
        expect("truncated" in text and "frames      " in text, f"{name}: {text}")
    bag = WORK / "damaged.mcap"
    bags.write_mcap(bag, log(hesai), compression="", chunk=10)
    data = bytearray(bag.read_bytes())
    data[len(data) // 2] ^= 1
    bag.write_bytes(data)
    expect("checksum" in run("info", bag, code=3), "a damaged chunk is not told")
    expect("skipped" in run("info", bag, "--set", "dataset.skip_broken=true"), "a damaged chunk is not left out")
    data = WORK / "empty.mcap"
    bags.write_mcap(data, [("/chatter", "std_msgs/String", T0, {"data": "x"})])
    expect("/chatter (std_msgs/String)" in run("info", data, code=3), "a bag without clouds")


def test_two():
    """Uses two LiDARs. The second LiDAR is 30 ms later and has a different mounting. A sweep must
    contain both."""
    second = {"offset_ns": 30_000_000, "mount": np.array([-1.0, 0.2, 2.0]), "yaw": -0.5}
    messages = poses("tf") + [("/tf_static", "tf2_msgs/TFMessage", T0, {"transforms": [transform(0, "base_link", "rear", second["mount"], -0.5)]})]
    for k in range(N):
        for topic, frame, given in (("/front", "lidar", {}), ("/rear", "rear", second)):
            stamp, value = velodyne(k, frame, **given)
            messages.append((topic, "sensor_msgs/PointCloud2", stamp, value))
    messages.sort(key=lambda m: m[2])
    bag = WORK / "two.mcap"
    bags.write_mcap(bag, messages, compression="lz4", chunk=4)
    folder, head, _ = convert(bag)
    expect([l["name"] for l in head["lidars"]] == ["/front", "/rear"], f"LiDARs {head['lidars']}")
    expect([(f["number"], f["lidar"]) for f in head["frames"]] == [(k, l) for k in range(N) for l in ("/front", "/rear")], "frames of two LiDARs")
    zero_s = 1e-9 * sweep(0)[1][0, -1]
    for f in head["frames"]:
        given = {} if f["lidar"] == "/front" else second
        scan = np.load(folder / f["scan"])
        hit = scan["range"] > 0
        p, t, _ = sweep(f["number"], **given)
        t = np.sort(t[np.isfinite(p[..., 0])])
        found = np.sort(scan["time"][hit].astype(float) + f["time_s"] + zero_s)
        expect(len(found) == len(t) and np.abs(found - 1e-9 * t).max() < 1e-6, "times of two LiDARs")
    mount = head["lidars"][1]["vehicle_from_sensor"]
    expect(np.abs(np.array(mount["translation"]) - second["mount"]).max() < 1e-9, f"mounting {mount}")
    check("one of two by dataset.lidars", bag, "dataset.lidars=/front", stamps="last")
    expect("/middle" in run("info", bag, "--set", "dataset.lidars=/middle", code=2), "a topic that is not there")


def test_poses():
    bag = WORK / "nowhere.mcap"
    bags.write_mcap(bag, [m for m in log(hesai) if m[0] != "/tf"])
    check("no poses", bag, poses_there=False)
    expect("estimated" in run("info", bag), "a bag without poses")
    bag = WORK / "choice.mcap"
    bags.write_mcap(bag, log(hesai) + poses("odometry")[1:])
    check("poses of a topic", bag, "dataset.poses_from=/odometry")
    expect("/odometry" in run("info", bag, "--set", "dataset.poses_from=/gps", code=2), "poses of a topic that is not there")
    renamed = log(hesai)
    for m in [m for m in renamed if m[0] == "/points"][3:]:
        m[3]["header"] = dict(m[3]["header"], frame_id="rear")
    bags.write_mcap(WORK / "frames.mcap", renamed)
    expect(names(run("info", WORK / "frames.mcap"), f"{N - 3} clouds ... 'rear' ... 'lidar'"), "clouds of two frames")


def test_jump():
    """A loop closure moves map -> odom at once by 0.6 m, within sweep 2."""
    messages, jump = log(hesai), T0 + 2 * STEP + STEP // 2
    for _, _, stamp, value in messages:
        for t in value.get("transforms", []):
            if t["header"]["frame_id"] == "map" and stamp > jump:
                t["transform"]["position"]["x"] += 0.6
    bags.write_mcap(WORK / "jump.mcap", messages)
    _, head, notes = convert(WORK / "jump.mcap")
    expect([f["number"] for f in head["frames"]] == [k for k in range(N) if k != 2], "the torn sweep is left out")
    expect(names(notes, "jump once, by 0.60 m at 0.26 s ... dataset.poses_from"), f"a note about the jump: {notes}")
    check("poses without a jump", WORK / "jump.mcap", "dataset.poses_from=odom", poses_there=False)
    expect("jump once" not in run("info", WORK / "jump.mcap", "--set", "dataset.poses_from=odom"), "odom does not jump")


def test_livox():
    """A Livox has line numbers, but the points of a line do not share an elevation."""
    rng, messages = np.random.default_rng(1), poses("tf")
    kept = []
    for k in range(N):
        az, el = rng.uniform(-0.6, 0.6, 3000), rng.uniform(-0.4, 0.4, 3000)
        d = np.stack([np.cos(el) * np.cos(az), np.cos(el) * np.sin(az), np.sin(el)], -1)
        p = (d * rng.uniform(5, 30, 3000)[:, None]).astype("f4")
        kept.append(p)
        stamp = T0 + k * STEP
        points = [{"offset_time": 33_000 * n, "x": q[0], "y": q[1], "z": q[2], "reflectivity": n % 256, "tag": 0, "line": n % 6}
                  for n, q in enumerate(p)]
        messages.append(("/livox/lidar", "livox_ros_driver2/CustomMsg", stamp, {
            "header": {"stamp": stamp, "frame_id": "lidar"}, "timebase": stamp, "point_num": 3000, "lidar_id": 1, "rsvd": [0] * 3,
            "points": points}))
    messages.sort(key=lambda m: m[2])
    for name, write in (("livox.mcap", lambda path: bags.write_mcap(path, messages)), ("livox.bag", lambda path: bags.write_ros1(path, messages))):
        write(WORK / name)
        folder, head, _ = convert(WORK / name)
        for k, f in enumerate(head["frames"]):
            scan = np.load(folder / f["scan"])
            expect(scan["range"].size == 3000, f"{name}: {scan['range'].size} rays")
            expect(np.abs(returns(scan)[0] - kept[k]).max() < 1e-4, f"{name}: points differ")
            expect(np.abs(scan["time"].ravel() - 33e-6 * np.arange(3000)).max() < 1e-6, f"{name}: times differ")
        expect(not head["lidars"][0]["spins"], f"{name}: it spins")


run_tests(test_mcap, test_db3, test_ros1, test_ends, test_two, test_poses, test_jump, test_livox, programs=("lz4", "zstd"))
