# SPDX-License-Identifier: Apache-2.0
"""Starts ros2_lidar.py with its parameters. ros2_lidar.md explains them.

    ros2 launch tools/examples/ros2_lidar.launch.py address:=127.0.0.1:50051 sensor:=OS1-128 loop:=true
"""
import pathlib

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue

DEFAULTS = {"address": "127.0.0.1:50051", "scene": "", "lidar": "", "sensor": "", "rate": 10.0, "topic": "/points", "frame": "lidar",
            "world": "map", "loop": False, "clock": False}


def generate_launch_description():
    arguments = [DeclareLaunchArgument(name, default_value=str(value)) for name, value in DEFAULTS.items()]
    parameters = {name: ParameterValue(LaunchConfiguration(name), value_type=type(value)) for name, value in DEFAULTS.items()}
    script = pathlib.Path(__file__).with_name("ros2_lidar.py")
    return LaunchDescription([*arguments, Node(executable=str(script), name="relidar", output="screen", parameters=[parameters])])
