# SPDX-License-Identifier: Apache-2.0
"""Renders the packets of a rig. Ports must be those of the makers. Times must equal those of the npz
files, of scans.json and of the bag, in which the C++ tests of packets compare each firing.

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
ports = {"front": 2368, "rear": 2370, "side": 2372, "roof": 7502, "view": 7504, "narrow": 2374}
bag = (scans / "rosbag.mcap").read_bytes()
n_packets = {}
for name, port in ports.items():
    packets = list(read_capture(scans / f"packets_{name}.pcap"))
    n_packets[name] = len(packets)
    assert {found for _, found, _ in packets} == {port}, f"{name}: ports"
    listed = json.loads((scans / name / "scans.json").read_text())
    assert listed["time_shift_ns"] == 0, f"{name}: {listed['time_shift_ns']} ns later"
    assert np.allclose([scan["time_s"] for scan in listed["scans"]], [0.4, 0.5, 0.6]), name
    first = np.load(scans / name / "frame_000000.npz")
    first_s = float(first["time_s"]) + first["time"].min()
    first_ns = round(1e9 * first_s)
    assert any(struct.pack("<II", 0, first_ns + off) in bag for off in range(-60, 61)), f"{name}: stamp of the bag"
    if "OS1" in sensors[name]:
        metadata = json.loads((scans / f"packets_{name}.json").read_text())
        assert (metadata["udp_port_lidar"], metadata["udp_port_imu"]) == (port, port + 1), name
    if "VLP" not in sensors[name]:   # packets without a return are not sent
        assert abs(packets[0][0] - first_s) < 4e-3, name
assert n_packets["narrow"] < 0.7 * n_packets["front"], f"packets outside the field of view: {n_packets}"
assert json.loads(run("info", scans / "packets_narrow.pcap", "--json"))["frames"] == 3, "turns of a field of view"

# The street is level, and the sensor of the log is 1.73 m above the road.
vehicle = json.loads((scans / "front/scans.json").read_text())["vehicle"]
assert abs(vehicle["base_link_height_m"]) < 0.05, vehicle
assert "base_link is " in said, said
assert np.allclose(np.array(vehicle["base_link_from_sensor"])[:3, 3], [1.0, 0.0, 1.73]), vehicle
print("passed")
