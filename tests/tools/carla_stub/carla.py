# SPDX-License-Identifier: Apache-2.0
"""Implements the few calls of CARLA's Python interface that tools/examples/carla_lidar.py makes.
The world has an ego vehicle and two cars. CARLA's frames are left-handed: x forward, y to the
right, z up, angles in degrees, yaw to the right, pitch up."""
import fnmatch
import math

TICK_S = 0.05
EGO, CAR, PASSING = 7, 11, 12


class Location:
    def __init__(self, x, y, z):
        self.x, self.y, self.z = x, y, z


class Rotation:
    def __init__(self, pitch=0.0, yaw=0.0, roll=0.0):
        self.pitch, self.yaw, self.roll = pitch, yaw, roll


class Transform:
    def __init__(self, location, rotation):
        self.location, self.rotation = location, rotation

    def get_matrix(self):
        c, s = math.cos, math.sin
        y, p, r = (math.radians(a) for a in (self.rotation.yaw, self.rotation.pitch, self.rotation.roll))
        at = self.location
        return [[c(p) * c(y), c(y) * s(p) * s(r) - s(y) * c(r), -c(y) * s(p) * c(r) - s(y) * s(r), at.x],
                [s(y) * c(p), s(y) * s(p) * s(r) + c(y) * c(r), -s(y) * s(p) * c(r) + c(y) * s(r), at.y],
                [s(p), -c(p) * s(r), c(p) * c(r), at.z],
                [0.0, 0.0, 0.0, 1.0]]


class BoundingBox:
    def __init__(self, location, extent):
        self.location, self.extent = location, extent


def transform_of(id, t):
    """Returns the transform of an actor at a time, or None if the actor is absent."""
    if id == EGO:   # drives at 6 m/s and turns to the right
        return Transform(Location(6.0 * t, 0.5 * t, 0.0), Rotation(yaw=20.0 * t))
    if id == CAR and t > 0.12:   # drives slightly to the right of the ego vehicle's path
        return Transform(Location(9.0 + 5.0 * t, 3.0, 0.0), Rotation(yaw=15.0))
    if id == PASSING and 0.22 < t < 0.42:
        return Transform(Location(8.0, -3.0, 0.0), Rotation(yaw=180.0))
    return None


class Actor:
    def __init__(self, id):
        self.id, self.type_id = id, "vehicle.stub.car"
        self.attributes = {"role_name": "hero" if id == EGO else "autopilot"}
        self.bounding_box = BoundingBox(Location(0.1, 0.05, 0.75), Location(2.1, 0.9, 0.75))


class ActorList(list):
    def filter(self, pattern):
        return ActorList(actor for actor in self if fnmatch.fnmatch(actor.type_id, pattern))


class ActorSnapshot:
    def __init__(self, transform):
        self.transform = transform

    def get_transform(self):
        return self.transform


class Timestamp:
    def __init__(self, elapsed_seconds):
        self.elapsed_seconds = elapsed_seconds


class WorldSnapshot:
    def __init__(self, frame):
        self.frame, self.timestamp = frame, Timestamp(frame * TICK_S)

    def find(self, id):
        transform = transform_of(id, self.timestamp.elapsed_seconds)
        return ActorSnapshot(transform) if transform else None


class World:
    def __init__(self):
        self.frame = -1

    def wait_for_tick(self):
        self.frame += 1
        return WorldSnapshot(self.frame)

    def get_actors(self):
        return ActorList(Actor(id) for id in (EGO, CAR, PASSING) if transform_of(id, self.frame * TICK_S))


class Client:
    def __init__(self, host, port):
        assert host == "127.0.0.1" and port == 2000

    def get_world(self):
        return World()
