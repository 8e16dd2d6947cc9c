#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Tests SensorsimService with a client that implements only the wire format. It encodes field
numbers and types byte by byte, without stubs. The client drives past the traffic of a served
street. Its scans must equal those of relidar's service, which are requested in the frame of the
*first* pose and transformed to the last pose here.

  sensorsim_client.py SOURCE_ROOT HOST:PORT SCENE

Prints errors and exits with code 1 if a check fails.
"""
import struct
import sys

import grpc
import numpy as np

root, address, scene = sys.argv[1:4]
sys.path.insert(0, f"{root}/tools/examples")
from checks import check, finish, render_service   # noqa: E402

channel = grpc.insecure_channel(address, options=[("grpc.max_receive_message_length", -1)])
# Wire format. A message is a list of (field number, value). A value is bytes, str, float
# (fixed32), Fixed64, int (varint) or a message.

class Fixed64(int):
    pass


def varint(n):
    parts = []
    while n > 0x7f:
        parts.append(n & 0x7f | 0x80)
        n >>= 7
    return bytes(parts + [n])


def encode(message):
    out = b""
    for number, value in message:
        if isinstance(value, Fixed64):
            out += varint(number << 3 | 1) + struct.pack("<Q", value)
        elif isinstance(value, float):
            out += varint(number << 3 | 5) + struct.pack("<f", value)
        elif isinstance(value, int):
            out += varint(number << 3) + varint(value)
        else:
            data = value if isinstance(value, bytes) else value.encode() if isinstance(value, str) else encode(value)
            out += varint(number << 3 | 2) + varint(len(data)) + data
    return out


def decode(data):
    """Decodes a message to {field number: [raw values]}. Packed arrays stay bytes."""
    fields, at = {}, 0

    def read_varint():
        nonlocal at
        n = shift = 0
        while True:
            byte = data[at]
            at += 1
            n |= (byte & 0x7f) << shift
            shift += 7
            if byte < 0x80:
                return n
    while at < len(data):
        key = read_varint()
        if key & 7 == 0:
            value = read_varint()
        else:
            size = {1: 8, 5: 4}.get(key & 7) or read_varint()
            value = data[at:at + size]
            at += size
        fields.setdefault(key >> 3, []).append(value)
    return fields


def call(name, message=()):
    return decode(channel.unary_unary(f"/nre.grpc.protos.sensorsim.SensorsimService/{name}")(encode(message), timeout=120))


# A pose is (rotation matrix, translation), with p' = R p + t.

def pose_of(q, t):
    w, x, y, z = q
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                     [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                     [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]]), np.array(t, float)


def pose_message(q, t):
    return [(1, [(i + 1, float(t[i])) for i in range(3)]), (2, [(i + 1, float(q[i])) for i in range(4)])]


def apply(pose, points):
    return points @ pose[0].T + pose[1]


def undo(pose, points):
    return (points - pose[1]) @ pose[0]


def read_pose(message):
    f = decode(message)
    t, q = decode(f[1][0]), decode(f[2][0])
    # the wire format omits zeros
    number = lambda fields, i: struct.unpack("<f", fields[i][0])[0] if i in fields else 0.0
    return [number(q, i) for i in (1, 2, 3, 4)], [number(t, i) for i in (1, 2, 3)]


# Checks the list of scenes and sensors that the server offers.

check("version", b"relidar" in call("get_version")[1][0])
check("scenes", scene.encode() in call("get_available_scenes")[1])
check("cameras", call("get_available_cameras", [(1, scene)]) == {})
check("ego masks", call("get_available_ego_masks") == {})
try:
    call("render_rgb", [(1, scene)])
    check("render_rgb", False)
except grpc.RpcError as error:
    check(f"render_rgb: {error.code()}", error.code() == grpc.StatusCode.UNIMPLEMENTED and "render_lidar" in error.details())
ways = [decode(decode(way)[2][0]) for way in call("get_available_trajectories", [(1, scene)])[1]]
log = []   # track of the LiDAR, which follows the track of the vehicle; the wire format omits time 0
for entry in map(decode, ways[1][1]):
    log.append((struct.unpack("<Q", entry.get(2, [bytes(8)])[0])[0], read_pose(entry[1][0])))
check("times rise", all(a[0] < b[0] for a, b in zip(log, log[1:])))

# A frame of the log with a faster and turning sensor, and with its traffic.

v1, own = render_service(address)
middle = len(log) // 2
time_us, (q0, t0) = log[middle]
tracks = own.GetTracks(v1.GetTracksRequest(scene=scene))
dataset = tracks.dataset_from_sensor[middle].pose.translation
# from the world of the protocol to the dataset's world
offset = np.array([dataset.x, dataset.y, dataset.z]) - t0
half = np.radians(5.0)   # turns ten degrees to the left during the frame
turn = [np.cos(half), 0.0, 0.0, np.sin(half)]
q1 = [turn[0] * q0[0] - turn[3] * q0[3], turn[0] * q0[1] - turn[3] * q0[2],
      turn[0] * q0[2] + turn[3] * q0[1], turn[0] * q0[3] + turn[3] * q0[0]]
t1 = list(np.array(t0) + pose_of(q0, t0)[0] @ [2.5, 0.0, 0.0])
start, end = pose_of(q0, t0), pose_of(q1, t1)


def request(lidar, objects):
    pair = lambda first, last: [(1, pose_message(*first)), (2, pose_message(*last))]
    message = [(1, scene), (2, [(2, lidar)]), (3, Fixed64(time_us)), (4, Fixed64(time_us + 100_000)), (5, pair((q0, t0), (q1, t1)))]
    return message + [(6, [(1, name), (2, pair(first, last))]) for name, (first, last) in objects.items()]


def floats(fields, number):
    return np.frombuffer(b"".join(fields.get(number, [])), "<f4")


def points_of(answer):
    n = answer.get(3, [0])[0]
    xyz, intensity = floats(answer, 4).reshape(-1, 3), floats(answer, 5)
    check(f"{n} points, buffers of {len(xyz)} and {len(intensity)}", n == len(xyz) == len(intensity))
    check("repeated floats are not the buffer's", np.array_equal(floats(answer, 1), xyz.ravel()) and
          np.array_equal(floats(answer, 2), intensity))
    check("intensities outside 0..1", len(intensity) and intensity.min() >= 0 and intensity.max() <= 1)
    return xyz.astype(float)


def own_points(sensor, objects):
    """Returns the points of relidar's service, in the frame of the first pose."""
    t = time_us * 1e-6
    pose = lambda q, p: v1.Pose(translation=v1.Vector(x=p[0], y=p[1], z=p[2]), rotation=v1.Quaternion(w=q[0], x=q[1], y=q[2], z=q[3]))
    # the transmitted value, bit by bit
    wide = lambda q, p: pose(np.float32(q).astype(float), np.float32(p).astype(float) + offset)
    path = lambda first, last: [v1.TimedPose(time_s=t, pose=wide(*first)), v1.TimedPose(time_s=t + 0.1, pose=wide(*last))]
    asked = v1.RenderLidarRequest(scene=scene, path=path((q0, t0), (q1, t1)), time_s=t + 0.05, points_at_s=t,
                                  sensor=v1.Sensor(name=sensor), wanted=v1.Wanted(points=True))
    asked.actors.SetInParent()
    for name, (first, last) in objects.items():
        asked.actors.actors.add(name=name, poses=path(first, last))
    return np.frombuffer(own.RenderLidar(asked, timeout=120).points.xyz_m, "<f4").reshape(-1, 3).astype(float)


ahead = [(q0, list(start[1] + start[0] @ [metres, 0.0, -1.0])) for metres in (9.0, 11.0)]
clouds = []
for lidar, sensor, objects in ((0, "Pandar128", {tracks.actors[0].name: ahead}), (1, "AT128", {})):
    clouds.append(points_of(call("render_lidar", request(lidar, objects))))
    first = own_points(sensor, objects)
    check(f"{sensor}: {len(clouds[-1])} points, {len(first)} of relidar's own service", len(clouds[-1]) == len(first) > 1000)
    if len(clouds[-1]) == len(first):
        off = np.linalg.norm(clouds[-1] - undo(end, apply(start, first)), axis=1)
        # single precision in the world of the dataset, and a few rays that graze
        check(f"{sensor}: points are {off.max():.4f} m off", off.max() < 2e-3)
        wrong = np.median(np.linalg.norm(clouds[-1] - first, axis=1))
        check(f"{sensor}: the two frames differ by {wrong} m only: nothing is tested", wrong > 0.5)

both = call("render_aggregated", [(2, request(0, {})), (2, request(1, {}))])
check("render_aggregated", len(both.get(2, [])) == 2 and 1 not in both and np.array_equal(points_of(decode(both[2][1])), clouds[1]))

finish()
