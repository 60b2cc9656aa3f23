"""A hand on ROS 2, driven by allegro_twin, and RViz beside it.

ros2 launch allegro_twin_ros hand.launch.py config:=can_v4_right rviz:=true
"""

from __future__ import annotations

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess
from launch.conditions import IfCondition
from launch.substitutions import EnvironmentVariable, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.substitutions import FindPackageShare


def generate_launch_description() -> LaunchDescription:
    """The driver is a program of its own: it publishes joint_states, tf and robot_description itself."""
    arguments = [
        DeclareLaunchArgument("config", default_value="sim_right", description="A config of allegro_twin."),
        DeclareLaunchArgument("namespace", default_value="/allegroHand_0", description="Of the hand's topics."),
        DeclareLaunchArgument("distro", default_value=EnvironmentVariable("ROS_DISTRO", default_value="jazzy")),
        DeclareLaunchArgument("rate", default_value="100", description="Hz, of what is published."),
        DeclareLaunchArgument("rviz", default_value="false"),
    ]
    driver = ExecuteProcess(
        cmd=[
            "allegro-twin", "ros2", LaunchConfiguration("config"),
            "--namespace", LaunchConfiguration("namespace"),
            "--distro", LaunchConfiguration("distro"),
            "--rate", LaunchConfiguration("rate"),
        ],
        output="screen",
        sigterm_timeout="10",
    )  # fmt: skip
    rviz = Node(
        package="rviz2",
        executable="rviz2",
        arguments=["-d", PathJoinSubstitution([FindPackageShare("allegro_twin_ros"), "config", "hand.rviz"])],
        condition=IfCondition(LaunchConfiguration("rviz")),
    )
    return LaunchDescription([*arguments, driver, rviz])
