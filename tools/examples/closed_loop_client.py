#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""A simulator that runs a closed loop at 10 Hz as a client of `relidar serve`. It moves the ego car and
an actor of the scene, and brakes depending on its simulated LiDAR. The ego car starts at the first
pose of the log. The actor drives 25 m in front of it and brakes after two seconds. The actor is the
first one of the scene, or a spawned asset.

    relidar serve RUN [--assets FOLDER] &
    tools/examples/closed_loop_client.py [HOST:PORT [SENSOR [ASSET]]]

Needs numpy, grpcio and protobuf (Debian: python3-numpy python3-grpcio python3-protobuf). To generate
stubs of the proto it also needs grpcio-tools of PyPI, or Debian's protobuf-compiler and
protobuf-compiler-grpc.
"""
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile

import grpc
import numpy as np

PROTO = pathlib.Path(__file__).resolve().parents[1] / "serve/relidar/v1/render.proto"
STEP_S, LANE_M, ACTOR_BRAKES, EGO_BRAKES = 0.1, 1.2, 4.0, 6.0   # Seconds, metres, m/s2.
SENSOR_M = 1.73   # Height above the road, as in KITTI and the demo.


def compile_proto(root, proto, folder):
    """Writes the stubs of a proto, whose path is relative to a root folder, into a folder."""
    plugin = shutil.which("grpc_python_plugin")
    compiler = ["protoc", f"--plugin=protoc-gen-grpc_python={plugin}"] if plugin else [sys.executable, "-m", "grpc_tools.protoc"]
    subprocess.run([*compiler, f"-I{root}", f"--python_out={folder}", f"--grpc_python_out={folder}", proto], check=True, cwd=root)


with tempfile.TemporaryDirectory() as stubs:
    compile_proto(PROTO.parents[2], "relidar/v1/render.proto", stubs)
    sys.path.insert(0, stubs)
    from relidar.v1 import render_pb2 as v1, render_pb2_grpc as v1_grpc


def connect(address):
    """Returns the calls of a server. The size of its answers is not limited."""
    return v1_grpc.RenderServiceStub(grpc.insecure_channel(address, options=[("grpc.max_receive_message_length", -1)]))


def find_scene(service, name):
    """Returns a scene of a server, the first if the name is empty."""
    scenes = service.ListScenes(v1.ListScenesRequest()).scenes
    for scene in scenes:
        if name in ("", scene.name):
            return scene
    raise SystemExit(f"--scene: found {name}, expected one of {', '.join(s.name for s in scenes)}")


def gap_ahead(points):
    """Distance to the nearest point ahead in the own lane, above the ground and beyond the own bonnet; 100 m where there is none."""
    xyz = np.frombuffer(points.xyz_m, "<f4").reshape(-1, 3)
    ahead = (xyz[:, 0] > 3) & (abs(xyz[:, 1]) < LANE_M) & (xyz[:, 2] > -1.2) & (xyz[:, 2] < 0.5)
    return float(xyz[ahead, 0].min(initial=100.0))


def forward(q):
    """The x axis of a quaternion's frame."""
    return np.array([1 - 2 * (q.y**2 + q.z**2), 2 * (q.x * q.y + q.w * q.z), 2 * (q.x * q.z - q.w * q.y)])


def lead_of(service, scene, asset):
    """Name and height of the actor that drives ahead: the first of the scene, or an asset under a name of our own."""
    if asset:
        lead = v1.Spawn(name=f"lead of {os.getpid()}", asset=asset)
        spawned = service.SpawnActors(v1.SpawnActorsRequest(scene=scene.name, actors=[lead])).actors[0]
        return spawned.name, spawned.size_m.z
    if not scene.actors:
        raise SystemExit(f"scene {scene.name} has no actors; expected at least one actor, or the name of an asset as the third argument")
    return scene.actors[0].name, scene.actors[0].size_m.z


def main(address="127.0.0.1:50051", sensor="", asset=""):
    service = connect(address)
    scene = find_scene(service, "")
    lead, height_m = lead_of(service, scene, asset)
    tracks = service.GetTracks(v1.GetTracksRequest(scene=scene.name))
    start = tracks.dataset_from_sensor[0].pose
    origin, axis = np.array([start.translation.x, start.translation.y, start.translation.z]), forward(start.rotation)

    def ahead(metres, up_m=0.0):
        x, y, z = origin + metres * axis + [0, 0, up_m]
        return v1.Pose(translation=v1.Vector(x=x, y=y, z=z), rotation=start.rotation)

    def drives(begin_s, begin_m, end_m, up_m=0.0):
        return [v1.TimedPose(time_s=begin_s, pose=ahead(begin_m, up_m)), v1.TimedPose(time_s=begin_s + STEP_S, pose=ahead(end_m, up_m))]

    ego_m, ego_mps, actor_m, actor_mps = 0.0, 8.0, 25.0, 8.0
    coarse = set()
    for step in range(80):
        t = scene.begin_s + step * STEP_S
        actor = v1.ActorTrack(name=lead, poses=drives(t, actor_m, actor_m + actor_mps * STEP_S, 0.5 * height_m - SENSOR_M))
        scan = service.RenderLidar(v1.RenderLidarRequest(
            scene=scene.name, sensor=v1.Sensor(name=sensor), path=drives(t, ego_m, ego_m + ego_mps * STEP_S),
            actors=v1.ActorTracks(actors=[actor])), timeout=30)
        gap_m = gap_ahead(scan.points)
        coarse.update(sparse.name for sparse in scan.sparse_actors)
        if gap_m < 6.0 + ego_mps**2 / (2 * EGO_BRAKES) * 1.3:
            ego_mps = max(0.0, ego_mps - EGO_BRAKES * STEP_S)
        if step * STEP_S > 2.0:
            actor_mps = max(0.0, actor_mps - ACTOR_BRAKES * STEP_S)
        if step % 10 == 0:
            print(f"{step * STEP_S:4.1f} s  ego {ego_mps:4.1f} m/s  actor {actor_mps:4.1f} m/s  nearest ahead {gap_m:5.1f} m  "
                  f"{scan.points.count} points in {scan.rendered_ms:.0f} ms")
        ego_m += ego_mps * STEP_S
        actor_m += actor_mps * STEP_S
    for name in coarse:
        print(f"actor {name} shows holes, because the log recorded it from farther away")
    if asset:
        service.DespawnActors(v1.DespawnActorsRequest(scene=scene.name, names=[lead]))
    print(f"stopped {actor_m - ego_m:.1f} m behind the actor")
    return 0 if ego_mps == 0.0 and actor_m - ego_m > 3.0 else 1


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
