# SPDX-License-Identifier: Apache-2.0
"""Renders the packets of a rig, and reads the captures with the parser below, which is written from
the makers' manuals. Ports must be those of the makers. Times must equal those of the npz files, of
scans.json and of the bag.

   rig_packets_test.py RELIDAR WORK       77: numpy or a Vulkan device is missing
"""
import json
import pathlib
import shutil
import struct
import subprocess
import sys

try:
    import numpy as np
except ImportError:
    sys.exit(77)

RELIDAR, WORK = str(pathlib.Path(sys.argv[1]).resolve()), pathlib.Path(sys.argv[2])
FIRING_S = 55.296e-6  # VLP-16: a block has two firings


def run(*words):
    done = subprocess.run([RELIDAR, *map(str, words)], cwd=WORK, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"relidar {' '.join(map(str, words))}: {done.stderr}")
    return done.stdout


def read_capture(file):
    """Yields the seconds, the destination port and the payload of each datagram."""
    data, at = file.read_bytes(), 24
    assert struct.unpack_from("<I", data)[0] == 0xA1B23C4D, "nanoseconds"
    while at < len(data):
        seconds, ns, size, _ = struct.unpack_from("<IIII", data, at)
        frame = data[at + 16:at + 16 + size]
        yield seconds + 1e-9 * ns, struct.unpack_from(">H", frame, 36)[0], frame[42:]
        at += 16 + size


def velodyne_times(time_s, payload):
    """Yields the times of the firings of a packet that have a return."""
    assert len(payload) == 1206
    assert abs(struct.unpack_from("<I", payload, 1200)[0] * 1e-6 - time_s % 3600) < 2e-6, "clock of the packet"
    for firing in range(24):
        block = 100 * (firing // 2) + 4 + 48 * (firing % 2)
        if any(struct.unpack_from("<H", payload, block + 3 * laser)[0] for laser in range(16)):
            yield time_s + firing * FIRING_S


def ouster_times(payload, pixels=64, pixel_bytes=12):
    """Yields the times of the columns of a packet of RNG19_RFL8_SIG16_NIR16 that were measured."""
    size = 12 + pixels * pixel_bytes
    assert len(payload) == 64 + 16 * size
    for at in range(32, 32 + 16 * size, size):
        if struct.unpack_from("<H", payload, at + 10)[0] & 1:
            yield 1e-9 * struct.unpack_from("<Q", payload, at)[0]


def scan_times(folder, returned):
    """Returns the sorted firing times of the columns in all npz files."""
    times = []
    for file in sorted(folder.glob("frame_*.npz")):
        scan = np.load(file)
        fired = (scan["drop_prob"] < 0.5) & (scan["range"] > 0) if returned else np.ones_like(scan["time"], bool)
        times.append(float(scan["time_s"]) + np.unique(np.round(scan["time"][fired].astype(float), 7)))
    return np.sort(np.concatenate(times))


def expect_equal(name, found, expected):
    found = np.sort(np.array(list(found)))
    assert len(found) == len(expected), f"{name}: {len(found)} firings, expected {len(expected)}"
    assert np.abs(found - expected).max() < 2e-6, f"{name}: times differ by {np.abs(found - expected).max()} s"


shutil.rmtree(WORK, ignore_errors=True)
(WORK / "street").mkdir(parents=True)
if subprocess.run([RELIDAR, "list", "devices"], capture_output=True).returncode:
    sys.exit(77)
(WORK / "street/street.toml").write_text("seed = 5\nn_frames = 12\nrows = 8\ncolumns = 96\n")
run("train", "street", "--out", "run", "--preset", "quick", "--set", "train.refine_poses=none", "--set",
    "init.actor_min_points=10", "--set", "train.iterations=6", "--no-eval", "--quiet")
sensors = {"front": "VLP-16", "rear": "VLP-16", "side": "XT32", "roof": "OS1-64:512x10",
           "view": "OS1-64:512x10:60..-60", "narrow": "VLP-16:100..-100"}
rig = {"sensors": [{"name": name, "sensor": sensor} for name, sensor in sensors.items()],
       "vehicle": {"length_m": 4.5, "width_m": 1.8, "height_m": 1.4, "rear_axle_to_front_m": 3.5,
                   "base_link_m": [-1.0, 0.0, -1.73], "points": "ego"}}
(WORK / "rig.json").write_text(json.dumps(rig))
(WORK / "path.csv").write_text("time_s,x,y,z,yaw_deg\n0.3,-6,0,1.73,0\n1.1,0,0,1.73,0\n")
said = run("render", "run", "--out", "scans", "--trajectory", "path.csv", "--times", "0.4:0.6:0.1", "--sensor", "rig.json",
           "--format", "npz,pcap,rosbag")
scans = WORK / "scans"
ports = {"front": 2368, "rear": 2370, "side": 2368, "roof": 7502, "view": 7504, "narrow": 2372}
bag = (scans / "rosbag.mcap").read_bytes()
n_packets = {}
for name, port in ports.items():
    packets = list(read_capture(scans / f"packets_{name}.pcap"))
    n_packets[name] = len(packets)
    assert {found for _, found, _ in packets} == {port}, f"{name}: ports"
    listed = json.loads((scans / name / "scans.json").read_text())
    assert listed["time_shift_ns"] == 0, f"{name}: {listed['time_shift_ns']} ns later"
    assert np.allclose([scan["time_s"] for scan in listed["scans"]], [0.4, 0.5, 0.6]), name
    first_ns = round(1e9 * scan_times(scans / name, False)[0])
    assert any(struct.pack("<II", 0, first_ns + off) in bag for off in range(-60, 61)), f"{name}: stamp of the bag"
    if "OS1" in sensors[name]:
        metadata = json.loads((scans / f"packets_{name}.json").read_text())
        assert (metadata["udp_port_lidar"], metadata["udp_port_imu"]) == (port, port + 1), name
        expect_equal(name, (t for _, _, data in packets for t in ouster_times(data)), scan_times(scans / name, False))
    elif "VLP" in sensors[name]:
        expect_equal(name, (t for time_s, _, data in packets for t in velodyne_times(time_s, data)), scan_times(scans / name, True))
    else:  # the time of a packet is that of the end of its last firing
        every = scan_times(scans / name, False)
        assert abs(packets[0][0] - every[0]) < 1e-3 and abs(packets[-1][0] - every[-1]) < 2e-3, name
assert n_packets["narrow"] < 0.7 * n_packets["front"], f"packets outside the field of view: {n_packets}"
assert json.loads(run("info", scans / "packets_narrow.pcap", "--json"))["frames"] == 3, "turns of a field of view"

# The street is level, and the sensor of the log is 1.73 m above the road.
vehicle = json.loads((scans / "front/scans.json").read_text())["vehicle"]
assert abs(vehicle["base_link_height_m"]) < 0.05, vehicle
assert "base_link is " in said, said
assert np.allclose(np.array(vehicle["base_link_from_sensor"])[:3, 3], [1.0, 0.0, 1.73]), vehicle
print("passed")
