#!/usr/bin/env python3
# SPDX-License-Identifier: Apache-2.0
"""Moves a LiDAR along the log's path through a trained scene. Publishes the scans of `relidar serve` as
sensor_msgs/PointCloud2, and the pose of the sensor on /tf.

    relidar serve RUN &
    tools/examples/ros2_lidar.py 127.0.0.1:50051 [--sensor OS1-128] [--topic /points] [--loop] [--clock]

ros2_lidar.md describes parameters, topics, stamps and frames.

Needs rclpy with sensor_msgs, geometry_msgs, rosgraph_msgs, tf2_msgs, and the packages of
closed_loop_client.py.
"""
import argparse
import sys
import time

import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion, Transform, TransformStamped, Vector3
from rclpy.utilities import remove_ros_args
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import PointCloud2, PointField
from std_msgs.msg import Header
from tf2_msgs.msg import TFMessage

from closed_loop_client import connect, find_scene, v1

POINT = np.dtype({"names": ["x", "y", "z", "intensity", "ring"], "formats": ["<f4", "<f4", "<f4", "<f4", "<u2"],
                  "offsets": [0, 4, 8, 12, 16], "itemsize": 20})
ROS_TYPES = {"<f4": PointField.FLOAT32, "<u2": PointField.UINT16}


def time_message(stamp_ns):
    return Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)


def cloud_message(points, stamp_ns, frame):
    """A v1.Points as a PointCloud2."""
    rows = np.zeros(points.count, POINT)
    rows["x"], rows["y"], rows["z"] = np.frombuffer(points.xyz_m, "<f4").reshape(-1, 3).T
    rows["intensity"] = np.frombuffer(points.intensity, "<f4")
    rows["ring"] = np.frombuffer(points.ring, "<u2")
    fields = [PointField(name=name, offset=POINT.fields[name][1], datatype=ROS_TYPES[POINT.fields[name][0].str], count=1)
              for name in POINT.names]
    return PointCloud2(header=Header(stamp=time_message(stamp_ns), frame_id=frame), height=1, width=len(rows), fields=fields,
                       is_bigendian=False, point_step=POINT.itemsize, row_step=POINT.itemsize * len(rows), data=rows.tobytes(),
                       is_dense=True)


def transform_message(pose, stamp_ns, parent, child):
    """A v1.Pose on /tf."""
    t, q = pose.translation, pose.rotation
    moved = Transform(translation=Vector3(x=t.x, y=t.y, z=t.z), rotation=Quaternion(x=q.x, y=q.y, z=q.z, w=q.w))
    return TFMessage(transforms=[TransformStamped(header=Header(stamp=time_message(stamp_ns), frame_id=parent), child_frame_id=child,
                                                  transform=moved)])


class Sweeps:
    """Scans along the log's way, one sweep after the other."""

    def __init__(self, service, options):
        self.service, self.options = service, options
        self.scene = find_scene(service, options.scene)
        self.path = list(service.GetTracks(v1.GetTracksRequest(scene=self.scene.name, lidar=options.lidar)).dataset_from_sensor)
        self.times_s = [pose.time_s for pose in self.path]
        self.period_s = 1.0 / options.rate
        self.count = int((self.path[-1].time_s - self.path[0].time_s) * options.rate + 1e-6)
        if self.count < 1:
            raise SystemExit(f"cannot render a sweep: the log of {self.scene.name} is shorter than {self.period_s:g} s")

    def scan(self, number):
        """@return v1.LidarScan, and the moment of its points in the log's time"""
        begin_s = self.path[0].time_s + number * self.period_s
        end_s = begin_s + self.period_s
        # Selects the poses of the sweep, one pose before it, and one pose after it.
        first = max(0, np.searchsorted(self.times_s, begin_s, "right") - 1)
        last = np.searchsorted(self.times_s, end_s, "left")
        request = v1.RenderLidarRequest(scene=self.scene.name, lidar=self.options.lidar, sensor=v1.Sensor(name=self.options.sensor),
                                        path=self.path[first:last + 1], time_s=0.5 * (begin_s + end_s), points_at_s=end_s)
        return self.service.RenderLidar(request, timeout=60), end_s


def read_parameters(node, options):
    """Declares each option as a parameter of the node, and reads the value of the parameter."""
    for name, value in vars(options).items():
        setattr(options, name, node.declare_parameter(name, value).value)


def options_parser():
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("address", nargs="?", default="127.0.0.1:50051", help="address of `relidar serve`")
    parser.add_argument("--scene", default="", help="scene of the server (default: the first)")
    parser.add_argument("--lidar", default="", help="LiDAR of the log whose path is used (default: the first)")
    parser.add_argument("--sensor", default="", help="sensor, a name of `relidar list sensors` (default: the LiDAR of --lidar)")
    parser.add_argument("--rate", type=float, default=10.0, help="sweeps per second; must be the rate of the sensor")
    parser.add_argument("--topic", default="/points")
    parser.add_argument("--frame", default="lidar", help="frame id of the points")
    parser.add_argument("--world", default="map", help="frame id of the dataset's world")
    parser.add_argument("--loop", action="store_true", help="start again at the end of the log")
    parser.add_argument("--clock", action="store_true", help="publish /clock, and use times of the log as stamps")
    return parser


def main(arguments=None):
    arguments = sys.argv if arguments is None else ["ros2_lidar.py", *arguments]
    options = options_parser().parse_args(remove_ros_args(arguments)[1:])
    rclpy.init(args=arguments)
    node = rclpy.create_node("relidar")
    read_parameters(node, options)
    sweeps = Sweeps(connect(options.address), options)
    clouds = node.create_publisher(PointCloud2, options.topic, 5)
    transforms = node.create_publisher(TFMessage, "/tf", 100)
    clock = node.create_publisher(Clock, "/clock", 10) if options.clock else None
    log = node.get_logger()
    begin_ns = round(sweeps.path[0].time_s * 1e9) if options.clock else node.get_clock().now().nanoseconds
    begin, done, late = time.monotonic(), 0, False
    try:
        while rclpy.ok() and (options.loop or done < sweeps.count):
            scan, _ = sweeps.scan(done % sweeps.count)
            done += 1
            stamp_ns = begin_ns + round(done * sweeps.period_s * 1e9)
            wait_s = begin + done * sweeps.period_s - time.monotonic()
            if wait_s > 0:
                time.sleep(wait_s)
            elif not late:
                late = True
                log.warning(f"rendering a sweep of {1e3 * sweeps.period_s:.0f} ms takes longer than the sweep, so the stamps fall behind the clock")
            if clock:
                clock.publish(Clock(clock=time_message(stamp_ns)))
            transforms.publish(transform_message(scan.dataset_from_points, stamp_ns, options.world, options.frame))
            clouds.publish(cloud_message(scan.points, stamp_ns, options.frame))
    except KeyboardInterrupt:
        pass
    node.destroy_node()
    if rclpy.ok():
        rclpy.shutdown()


if __name__ == "__main__":
    main()
