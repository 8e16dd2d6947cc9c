#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Runs tools/examples/ros2_lidar.py with a stub of rclpy and a running server. bag_writer.py, which
uses no code of relidar, writes the published messages into an MCAP. `relidar convert` reads the
MCAP. The clouds must equal the clouds of the service, at the positions in /tf.

  ros2_test.py SOURCE_ROOT RELIDAR HOST:PORT WORK

Prints errors and exits with code 1 if a check fails.
"""
import json
import pathlib
import runpy
import subprocess
import sys
import types

import numpy as np

root, relidar, address, work = pathlib.Path(sys.argv[1]), sys.argv[2], sys.argv[3], pathlib.Path(sys.argv[4])
sys.path[:0] = [str(root / "tests/tools"), str(root / "tools/examples")]
import bag_writer   # noqa: E402
from checks import check, finish, render_service   # noqa: E402

published, declared = [], []
START_NS = 1_700_000_000_250_000_000


def message_type(**constants):
    """Returns a class for messages. A message has the attributes that its constructor receives."""
    return type("Message", (), {"__init__": lambda self, **fields: self.__dict__.update(fields), **constants})


def module(name, **content):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].__dict__.update(content)


class Node:
    parameters = {}   # parameters that a launch file or `--ros-args` sets

    def declare_parameter(self, name, value):
        declared.append(name)
        return types.SimpleNamespace(value=self.parameters.get(name, value))

    def create_publisher(self, kind, topic, depth):
        return types.SimpleNamespace(publish=lambda message: published.append((topic, kind, message)))

    def get_clock(self):
        return types.SimpleNamespace(now=lambda: types.SimpleNamespace(nanoseconds=START_NS))

    def get_logger(self):
        return types.SimpleNamespace(warning=print)

    def destroy_node(self):
        pass


for package, names in (("builtin_interfaces", ["Time"]), ("std_msgs", ["Header"]), ("rosgraph_msgs", ["Clock"]), ("tf2_msgs", ["TFMessage"]),
                       ("sensor_msgs", ["PointCloud2"]), ("geometry_msgs", ["Quaternion", "Transform", "TransformStamped", "Vector3"])):
    module(package)
    module(package + ".msg", **{name: message_type() for name in names})
# values from the definition of the message
sys.modules["sensor_msgs.msg"].PointField = message_type(UINT16=4, FLOAT32=7)
module("rclpy.utilities", remove_ros_args=lambda arguments: arguments)
module("rclpy", init=lambda args: None, ok=lambda: True, shutdown=lambda: None, create_node=lambda name: Node())

import ros2_lidar   # noqa: E402

ros2_lidar.main([address, "--sensor", "VLP-16", "--topic", "/front/points", "--frame", "front"])

of_options = list(published)
published.clear()

# The launch file and the node must have the same parameters.
record = lambda kind: lambda *arguments, **fields: (kind, arguments, fields)
module("launch", LaunchDescription=list)
module("launch.actions", DeclareLaunchArgument=record("argument"))
module("launch.substitutions", LaunchConfiguration=lambda name: name)
module("launch_ros")
module("launch_ros.actions", Node=record("node"))
module("launch_ros.parameter_descriptions", ParameterValue=lambda name, value_type: (name, value_type))
launch = runpy.run_path(str(root / "tools/examples/ros2_lidar.launch.py"))
entries = launch["generate_launch_description"]()
node = next(fields for kind, _, fields in entries if kind == "node")
check("launch file: the script is missing", pathlib.Path(node["executable"]).is_file())
names = [arguments[0] for kind, arguments, _ in entries if kind == "argument"]
check(f"launch file: arguments {names}, parameters {declared}", names == list(node["parameters"][0]) == declared)
defaults = vars(ros2_lidar.options_parser().parse_args([]))
check(f"launch file: defaults {launch['DEFAULTS']}, expected {defaults}", launch["DEFAULTS"] == defaults)
Node.parameters = {"address": address, "sensor": "VLP-16:90x5", "rate": 5.0, "topic": "/roof", "frame": "roof", "clock": True}
ros2_lidar.main([])
stamps = {topic: [] for topic in ("/roof", "/tf", "/clock")}
for topic, _, message in published:
    time = message.clock if topic == "/clock" else message.header.stamp if topic == "/roof" else message.transforms[0].header.stamp
    stamps[topic].append(time.sec * 10**9 + time.nanosec)
    check(f"{topic} before its time on /clock", stamps["/clock"] and stamps["/clock"][-1] == stamps[topic][-1])
published[:] = of_options


def plain(message):
    """Converts a message to the nested dicts of bag_writer: stamps become ns, and translation and
    rotation become position and orientation."""
    if isinstance(message, list):
        return [plain(item) for item in message]
    if not hasattr(message, "__dict__"):
        return message
    fields = {name: plain(value) for name, value in vars(message).items()}
    if set(fields) == {"sec", "nanosec"}:
        return fields["sec"] * 10**9 + fields["nanosec"]
    if set(fields) == {"translation", "rotation"}:
        return {"position": fields["translation"], "orientation": fields["rotation"]}
    return fields


types_of = {"/tf": "tf2_msgs/TFMessage", "/front/points": "sensor_msgs/PointCloud2"}
messages = []
for topic, _, message in published:
    value = plain(message)
    header = value["header"] if "header" in value else value["transforms"][0]["header"]
    messages.append((topic, types_of[topic], header["stamp"], value))
work.mkdir(parents=True, exist_ok=True)
bag_writer.write_mcap(work / "published.mcap", messages)

v1, service = render_service(address)
way = service.GetTracks(v1.GetTracksRequest()).dataset_from_sensor
clouds = [value for topic, _, _, value in messages if topic == "/front/points"]
log_ns = round(way[0].time_s * 1e9)
expected = [log_ns + k * 200_000_000 for k in range(1, 1 + int((way[-1].time_s - way[0].time_s) * 5 + 1e-6))]
check(f"/clock at {stamps['/clock']}, expected {expected}", stamps["/clock"] == expected and len(expected) > 3)
frames = [value["transforms"][0] for topic, _, _, value in messages if topic == "/tf"]
sweeps = round((way[-1].time_s - way[0].time_s) * 10)
check(f"{len(clouds)} clouds and {len(frames)} transforms, expected {sweeps}", len(clouds) == len(frames) == sweeps > 5)

done = subprocess.run([relidar, "convert", str(work / "published.mcap"), "--out", str(work / "read"), "--set", "dataset.max_range_m=200"],
                      capture_output=True, text=True)
check(f"relidar convert: {done.stdout}{done.stderr}", done.returncode == 0)
read = json.loads((work / "read/sequence.json").read_text())["frames"] if done.returncode == 0 else []
check(f"{len(read)} frames read, expected {len(clouds)}", len(read) == len(clouds))
poses = np.loadtxt(work / "read/poses.txt", ndmin=2) if read else []

for k, (cloud, frame, entry) in enumerate(zip(clouds, frames, read)):
    stamp = START_NS + (k + 1) * 100_000_000
    check(f"cloud {k}: stamped {cloud['header']}, expected {stamp}", cloud["header"] == {"stamp": stamp, "frame_id": "front"})
    check(f"transform {k}: {frame['header']}", frame["header"] == {"stamp": stamp, "frame_id": "map"} and frame["child_frame_id"] == "front")
    end_s = way[0].time_s + 0.1 * (k + 1)
    truth = service.RenderLidar(v1.RenderLidarRequest(sensor=v1.Sensor(name="VLP-16"), path=way, time_s=end_s - 0.05, points_at_s=end_s))
    points = np.frombuffer(truth.points.xyz_m, "<f4").reshape(-1, 3)
    rows = np.frombuffer(cloud["data"], "u1").reshape(cloud["width"], cloud["point_step"])
    for field in cloud["fields"]:   # names from the definition of the message
        size, code = {7: (4, "<f4"), 4: (2, "<u2")}[field["datatype"]]
        values = np.ascontiguousarray(rows[:, field["offset"]:field["offset"] + size]).view(code)[:, 0]
        expected = {"x": points[:, 0], "y": points[:, 1], "z": points[:, 2], "intensity": np.frombuffer(truth.points.intensity, "<f4"),
                    "ring": np.frombuffer(truth.points.ring, "<u2")}[field["name"]]
        check(f"cloud {k}: {field['name']} differs", np.array_equal(values, expected))
    scan = np.load(work / "read" / entry["scan"])
    hit = scan["range"] > 0
    found = (scan["origin"] + scan["range"][..., None] * scan["directions"])[hit]
    # If two points belong to one pixel, the reader keeps the nearer one.
    check(f"cloud {k}: {len(found)} of {len(points)} points read", 0.95 * len(points) < len(found) <= len(points))
    apart = max(np.linalg.norm(points - point, axis=1).min() for point in found[::100])
    check(f"cloud {k}: points were read {apart} m off", apart < 1e-3)
    at, t = truth.dataset_from_points.translation, frame["transform"]["position"]
    check(f"transform {k}: {t}, expected {at}", np.allclose([t[axis] for axis in "xyz"], [at.x, at.y, at.z], atol=1e-9))
    check(f"pose {k}: {poses[k]}, expected {at}", np.allclose(poses[k][1:4], [at.x, at.y, at.z], atol=1e-5))

finish()
