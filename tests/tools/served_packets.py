#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Renders scans of a `relidar serve --udp` and receives their packets. The packets must decode to
the points of the answers. Sensors without packets and calls of a rig must be refused.

  served_packets.py SOURCE_ROOT HOST:PORT UDP_PORT RELIDAR WORK [realtime]

Prints errors and exits with code 1 if a check fails.
"""
import json
import pathlib
import socket
import subprocess
import sys
import time

import grpc
import numpy as np

root, address, udp_port, relidar, work = sys.argv[1:6]
is_realtime = "realtime" in sys.argv[6:]
sys.path[:0] = [f"{root}/tools/examples", f"{root}/tests/tools"]
import capture_writer as captures
from closed_loop_client import v1, v1_grpc   # generates the stubs

N_SCANS, PERIOD_S = 4, 0.1


def expect(condition, text):
    if not condition:
        sys.exit(f"FAILED: {text}")


def expect_refusal(call, request, code, text):
    try:
        list(call(request, timeout=60))   # a rig answers with a stream
    except grpc.RpcError as error:
        expect(error.code() == code and text in error.details(), f"{error.code()}: {error.details()}, expected {code}: {text}")
        return
    except TypeError:
        pass   # an answer is no list
    expect(False, f"a request was answered, expected {code}: {text}")


receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
receiver.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
receiver.bind(("127.0.0.1", int(udp_port)))
receiver.settimeout(0.2)

service = v1_grpc.RenderServiceStub(grpc.insecure_channel(address))
pose = v1.Pose(translation=v1.Vector(x=4.0, y=0.5, z=1.73))
request = v1.RenderLidarRequest(path=[v1.TimedPose(time_s=t, pose=pose) for t in (0.0, 1.0)], wanted=v1.Wanted(points=True))
request.sensor.name = "VLP-16"
scans, packets = [], []
for k in range(N_SCANS):
    request.time_s = request.points_at_s = 0.3 + PERIOD_S * k
    began_s = time.monotonic()
    scans.append(service.RenderLidar(request, timeout=60))
    if is_realtime and k > 0:
        expect(time.monotonic() - began_s > 0.97 * PERIOD_S, f"scan {k} was answered after {time.monotonic() - began_s} s, expected the time of a turn")
    # the packets were sent before the answer
    while True:
        try:
            packets.append(receiver.recv(2048))
        except TimeoutError:
            break
expect(len(packets) > (N_SCANS - 1) * 75 and {len(p) for p in packets} == {1206}, f"{len(packets)} packets of {({len(p) for p in packets})} bytes")
azimuths = np.array([int.from_bytes(p[2:4], "little") for p in packets])
expect((np.diff(azimuths) % 36000 < 600).all(), "the packets are not in order")

capture, log = pathlib.Path(work) / "served.pcap", pathlib.Path(work) / "served_log"
captures.write(capture, [(1_700_000_000_000_000_000 + 1_327_104 * k, captures.frame(p)) for k, p in enumerate(packets)])
done = subprocess.run([relidar, "convert", capture, "--out", log, "--force", "--quiet", "--set", "dataset.poses=none", "--set", "dataset.max_range_m=200"],
                      capture_output=True, text=True)
expect(done.returncode == 0, done.stdout + done.stderr)
frames = json.loads((log / "sequence.json").read_text())["frames"]
expect(len(frames) >= N_SCANS - 1, f"{len(frames)} scans in the packets")
for frame, scan in zip(frames, scans):
    decoded = np.load(log / frame["scan"])
    hit = decoded["range"] > 0
    points = np.frombuffer(scan.points.xyz_m, "<f4").reshape(-1, 3).astype(float)
    rings = np.frombuffer(scan.points.ring, "<u2")
    expect(abs(hit.sum() - len(points)) < 0.01 * len(points) > 10, f"{hit.sum()} returns in the packets, expected {len(points)}")
    n_equal = 0
    for ring in range(16):
        of_ring = hit & (decoded["ring"] == ring)
        truth = points[rings == ring]
        # the beams of a VLP-16 start above or below the centre of the sensor
        found = decoded["origin"][of_ring] + decoded["range"][of_ring][:, None] * decoded["directions"][of_ring].astype(float)
        if len(truth) == 0 or len(found) == 0:
            continue
        ranges = np.linalg.norm(found, axis=1)
        found /= ranges[:, None]
        direction = truth / np.linalg.norm(truth, axis=1)[:, None]
        nearest = (found @ direction.T).argmax(1)
        apart_deg = np.degrees(np.linalg.norm(found - direction[nearest], axis=1))
        off_m = np.abs(np.linalg.norm(truth[nearest], axis=1) - ranges)
        n_equal += ((apart_deg < 0.012) & (off_m < 0.0011)).sum()
    expect(n_equal > 0.99 * len(points), f"{n_equal} of {len(points)} points are in the packets")

invalid = grpc.StatusCode.INVALID_ARGUMENT
service.RenderLidar(request, timeout=60)   # a repeated time starts new packets
request.time_s = request.points_at_s = request.time_s + 0.5 * PERIOD_S
expect_refusal(service.RenderLidar, request, invalid, "expected scans that do not overlap")
request.sensor.name = "rosette"
expect_refusal(service.RenderLidar, request, invalid, 'cannot write packets of the sensor "rosette", expected one of VLP-16')
request.sensor.name = "HDL-64E"
expect_refusal(service.RenderLidar, request, invalid, "cannot write packets of the sensor")
rays = v1.RayTable(direction=np.array([1, 0, 0], "<f4").tobytes())
request.sensor.spec.CopyFrom(v1.SensorSpec(name="VLP-16", rays=rays))
expect_refusal(service.RenderLidar, request, invalid, "sensor.spec or sensor.handle; expected sensor.name")
expect_refusal(service.RenderRig, v1.RenderRigRequest(), grpc.StatusCode.FAILED_PRECONDITION, "expected RenderLidar calls")
print(f"{len(packets)} packets of {N_SCANS} scans")
