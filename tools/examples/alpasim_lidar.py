#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Requests LiDAR scans through the gRPC interface of NuRec, as AlpaSim does. The sensor follows the log.
Each actor of the log moves from its pose at the start of a frame to its pose at the end.

    relidar serve RUN --api sensorsim &
    tools/examples/alpasim_lidar.py 127.0.0.1:50051 nre.grpc.protos scans

The arguments are the address of the server, the package of the interface and a folder for the scans. The
package is nre.grpc.protos, or nurec.grpc.protos for NuRec 26.10. A scan is written as float32 x, y, z,
intensity. The script needs the same packages as closed_loop_client.py.
"""
import pathlib
import sys
import tempfile

import grpc
import numpy as np

from closed_loop_client import PROTO, compile_proto

FRAME_US, N_FRAMES = 100_000, 3
address, package, folder = sys.argv[1:]
with tempfile.TemporaryDirectory() as stubs:
    text = (PROTO.parents[2] / "sensorsim/sensorsim.proto").read_text()
    pathlib.Path(stubs, "sensorsim.proto").write_text(text.replace("nre.grpc.protos", package))
    compile_proto(stubs, "sensorsim.proto", stubs)
    sys.path.insert(0, stubs)
    import sensorsim_pb2 as wire
    import sensorsim_pb2_grpc as wire_grpc


def pair_at(poses, start_us):
    """Returns the poses of a trajectory at the start and at the end of a frame: the nearest ones."""
    nearest = lambda time_us: min(poses, key=lambda pose: abs(pose.timestamp_us - time_us)).pose
    return wire.PosePair(start=nearest(start_us), end=nearest(start_us + FRAME_US))


service = wire_grpc.SensorsimServiceStub(grpc.insecure_channel(address, options=[("grpc.max_receive_message_length", -1)]))
scene = wire.SceneRequest(scene_id=service.get_available_scenes(wire.Empty()).scene_ids[0])
sensor = service.get_available_trajectories(scene).trajectories[1].trajectory.poses
actors = service.get_dynamic_objects(scene).dynamic_objects
pathlib.Path(folder).mkdir(parents=True, exist_ok=True)
for frame in range(min(N_FRAMES, len(sensor))):
    start_us = sensor[frame].timestamp_us
    request = wire.LidarRenderRequest(scene_id=scene.scene_id, frame_start_us=start_us, frame_end_us=start_us + FRAME_US,
                                      sensor_pose=pair_at(sensor, start_us))
    for actor in actors:
        poses = actor.trajectory.poses
        if poses[0].timestamp_us <= start_us <= poses[-1].timestamp_us:
            request.dynamic_objects.add(track_id=actor.id, pose=pair_at(poses, start_us))
    scan = service.render_lidar(request)
    xyz = np.frombuffer(scan.xyz_buffer, "<f4").reshape(-1, 3)
    points = np.column_stack([xyz, np.frombuffer(scan.intensity_buffer, "<f4")])
    points.tofile(pathlib.Path(folder, f"{frame:06d}.bin"))
    print(f"{package}: frame {frame}: {scan.count} points, {len(request.dynamic_objects)} actors")
loaded = service.get_loaded_scenes(wire.Empty())
print(f"{package}: {', '.join(entry.scene_id for entry in loaded.scenes)} loaded")
