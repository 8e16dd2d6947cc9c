#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Simulates a LiDAR in a trained scene through `relidar serve`. The sensor follows the ego vehicle,
and actors follow the traffic of a CARLA world.

    relidar serve RUN --assets FOLDER &
    tools/examples/carla_lidar.py 127.0.0.1:50051 --out scans [--ego hero] [--sensor VLP-32C] [--mount 0,0,1.8,0]

Each vehicle and walker except the ego vehicle becomes the actor or asset of the scene that is most
similar in size, and moves it. Each scan is a file FRAME.bin of float32 x, y, z, intensity in the
layout of CARLA's LidarMeasurement.raw_data: in the sensor's frame, with y to the right.

Frames: CARLA uses left-handed frames, with x forward, y right, z up, and yaw to the right. Relidar
uses right-handed frames, with x forward, y left, z up. Changing the sign of y converts between them:
with M = diag(1, -1, 1), a point p becomes M p and a rotation R becomes M R M. A yaw of 30 degrees to
the right becomes a yaw of -30 degrees. Euler angles are not needed, because a CARLA transform provides
its matrix. --dataset-from-carla is the pose of the origin of CARLA's map in the dataset's world, which
is right-handed: x,y,z in metres and yaw to the left in degrees.

Needs carla and the packages of closed_loop_client.py.
"""
import argparse
import pathlib

import numpy as np

from closed_loop_client import connect, find_scene, v1

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])   # Converts between left-handed and right-handed frames.
NEARLY = 1e-6   # Tolerance in seconds for a period that consists of ticks.


def right_handed(transform):
    """Returns the [4,4] matrix of a carla.Transform."""
    return MIRROR @ np.array(transform.get_matrix()) @ MIRROR


def pose_matrix(x, y, z, yaw_deg):
    """[4,4], right-handed."""
    c, s = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, z], [0, 0, 0, 1]], float)


def pose_message(matrix):
    """Shepperd's method: the largest of the four components is found first, so that none is divided by a small number."""
    r = matrix[:3, :3]
    squares = np.array([1 + r[0, 0] + r[1, 1] + r[2, 2], 1 + r[0, 0] - r[1, 1] - r[2, 2],
                        1 - r[0, 0] + r[1, 1] - r[2, 2], 1 - r[0, 0] - r[1, 1] + r[2, 2]])
    a, b, c = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
    d, e, f = r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1]
    rows = ([squares[0], a, b, c], [a, squares[1], d, e], [b, d, squares[2], f], [c, e, f, squares[3]])
    q = np.array(rows[squares.argmax()])
    q /= np.linalg.norm(q)
    return v1.Pose(translation=v1.Vector(x=matrix[0, 3], y=matrix[1, 3], z=matrix[2, 3]),
                   rotation=v1.Quaternion(w=q[0], x=q[1], y=q[2], z=q[3]))


def box_matrix(actor, transform):
    """[4,4] of the middle of an actor's box, right-handed: that is what relidar places."""
    middle = np.eye(4)
    middle[:3, 3] = [actor.bounding_box.location.x, -actor.bounding_box.location.y, actor.bounding_box.location.z]
    return right_handed(transform) @ middle


class Traffic:
    """The actors of a CARLA world as spawned actors of the scene, under names of this client's."""

    def __init__(self, service, scene):
        self.service, self.scene, self.names = service, scene.name, {}
        listed = service.ListScenes(v1.ListScenesRequest())
        size = lambda message: np.array([message.size_m.x, message.size_m.y, message.size_m.z])
        self.models = [(size(a), {"asset": a.name}) for a in listed.assets] + [(size(a), {"actor": a.name}) for a in scene.actors]

    def follow(self, actors):
        """Spawns those that are new, and takes those out that have gone."""
        gone = [name for id, name in self.names.items() if id not in actors]
        new = {id: actor for id, actor in actors.items() if id not in self.names}
        if gone:
            self.service.DespawnActors(v1.DespawnActorsRequest(scene=self.scene, names=gone))
        self.names = {id: name for id, name in self.names.items() if id in actors}
        if new and not self.models:
            raise SystemExit(f"cannot show the traffic of CARLA: the scene {self.scene} has no actors and the server has no assets; use relidar serve --assets FOLDER")
        if new:
            spawns = [v1.Spawn(name=f"carla {id}", **self.model_of(actor)) for id, actor in new.items()]
            self.service.SpawnActors(v1.SpawnActorsRequest(scene=self.scene, actors=spawns))
            self.names.update({id: f"carla {id}" for id in new})

    def model_of(self, actor):
        extent = actor.bounding_box.extent   # Half of the box's size.
        wanted = 2 * np.array([extent.x, extent.y, extent.z])
        return min(self.models, key=lambda model: abs(model[0] - wanted).sum())[1]


class CarlaLidar:
    """Scans of a scene along the way of CARLA's ego vehicle: tick() takes each world snapshot, and returns a scan once a sweep is over."""

    def __init__(self, service, world, options):
        self.scene = find_scene(service, options.scene)
        self.service, self.world, self.options = service, world, options
        self.traffic = Traffic(service, self.scene)
        self.dataset_from_carla = pose_matrix(*options.dataset_from_carla)
        self.ego_from_sensor = pose_matrix(*options.mount)
        self.ego = None
        # Ticks since the start of the sweep. Each entry has CARLA's time in seconds, the
        # pose of the sensor, and a dict from actor id to pose.
        self.history = []

    def find_ego(self):
        for actor in self.world.get_actors().filter("vehicle.*"):
            if actor.attributes.get("role_name") == self.options.ego:
                return actor
        raise SystemExit(f"--ego: found no vehicle with role_name {self.options.ego} in CARLA's world")

    def tick(self, snapshot):
        """@return [n,4] x, y, z, intensity in CARLA's frame of the sensor, or None while the sweep lasts."""
        self.ego = self.ego or self.find_ego()
        everybody = self.world.get_actors()
        others = {a.id: a for kind in ("vehicle.*", "walker.*") for a in everybody.filter(kind) if a.id != self.ego.id}
        found = {id: snapshot.find(id) for id in [self.ego.id, *others]}
        if found[self.ego.id] is None:
            raise SystemExit("the ego vehicle no longer exists in CARLA's world")
        others = {id: actor for id, actor in others.items() if found[id] is not None}
        boxes = {id: self.dataset_from_carla @ box_matrix(actor, found[id].get_transform()) for id, actor in others.items()}
        sensor = self.dataset_from_carla @ right_handed(found[self.ego.id].get_transform()) @ self.ego_from_sensor
        self.history.append((snapshot.timestamp.elapsed_seconds, sensor, boxes))
        if self.history[-1][0] - self.history[0][0] < 1.0 / self.options.rate - NEARLY:
            return None
        self.traffic.follow(others)
        points = self.render(others)
        self.history = self.history[-1:]
        return points

    def render(self, others):
        # Requests every sweep for the time at which the log begins.
        begin_s = self.scene.begin_s - self.history[0][0]
        path = [v1.TimedPose(time_s=begin_s + t, pose=pose_message(sensor)) for t, sensor, _ in self.history]
        tracks = [v1.ActorTrack(name=self.traffic.names[id], poses=[
            v1.TimedPose(time_s=begin_s + t, pose=pose_message(boxes[id])) for t, _, boxes in self.history if id in boxes]) for id in others]
        request = v1.RenderLidarRequest(scene=self.scene.name, sensor=v1.Sensor(name=self.options.sensor), path=path,
                                        actors=v1.ActorTracks(actors=tracks))
        points = self.service.RenderLidar(request, timeout=60).points
        # Negates y, because CARLA's frame is left-handed.
        xyz = np.frombuffer(points.xyz_m, "<f4").reshape(-1, 3) * np.float32([1, -1, 1])
        return np.column_stack([xyz, np.frombuffer(points.intensity, "<f4")])

    def leave(self):
        self.traffic.follow({})


def numbers(text):
    values = [float(word) for word in text.split(",")]
    if len(values) != 4:
        raise argparse.ArgumentTypeError("expected four numbers: x,y,z,yaw")
    return values


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("address", nargs="?", default="127.0.0.1:50051", help="address of `relidar serve`")
    parser.add_argument("--carla", default="127.0.0.1:2000", help="address of the CARLA server")
    parser.add_argument("--scene", default="", help="scene of the server (default: the first)")
    parser.add_argument("--ego", default="hero", help="role_name of the vehicle that carries the sensor")
    parser.add_argument("--sensor", default="", help="sensor, a name of `relidar list sensors` (default: the sensor of the log)")
    parser.add_argument("--rate", type=float, default=10.0, help="sweeps per second; must be the rate of the sensor")
    parser.add_argument("--mount", type=numbers, default=[0, 0, 1.8, 0], metavar="X,Y,Z,YAW",
                        help="pose of the sensor on the ego vehicle, right-handed: metres forward, left, up and degrees to the left")
    parser.add_argument("--dataset-from-carla", type=numbers, default=[0, 0, 0, 0], metavar="X,Y,Z,YAW",
                        help="pose of the origin of CARLA's map in the dataset's world, right-handed")
    parser.add_argument("--scans", type=int, default=0, help="number of scans to receive (default: until Ctrl-C)")
    parser.add_argument("--out", type=pathlib.Path, help="folder for the scans, as FRAME.bin")
    options = parser.parse_args()
    import carla
    host, port = options.carla.rsplit(":", 1)
    world = carla.Client(host, int(port)).get_world()
    lidar = CarlaLidar(connect(options.address), world, options)
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
    n_scans = 0
    try:
        while options.scans == 0 or n_scans < options.scans:
            snapshot = world.wait_for_tick()
            points = lidar.tick(snapshot)
            if points is None:
                continue
            n_scans += 1
            print(f"frame {snapshot.frame}: {len(points)} points, {len(lidar.traffic.names)} actors")
            if options.out:
                points.astype("<f4").tofile(options.out / f"{snapshot.frame:06d}.bin")
    except KeyboardInterrupt:
        pass
    finally:
        lidar.leave()


if __name__ == "__main__":
    main()
