"""All nodes of spacearm_ident: driver, trajectory, recorder, identifier, and the simulated arm on request."""

from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchDescription

PACKAGE = "spacearm_ident"


def generate_launch_description() -> LaunchDescription:
    config = PathJoinSubstitution([FindPackageShare(PACKAGE), "config"])

    def argument(name: str, default: object, description: str) -> DeclareLaunchArgument:
        return DeclareLaunchArgument(name, default_value=default, description=description)

    def node(name: str, condition: IfCondition | None = None, **parameters: object) -> Node:
        return Node(
            package=PACKAGE,
            executable=name,
            name=name,
            namespace=LaunchConfiguration("namespace"),
            output="screen",
            parameters=[LaunchConfiguration("params"), parameters],
            condition=condition,
        )

    def text(name: str) -> ParameterValue:
        # An empty or odd-looking argument stays a string.
        return ParameterValue(LaunchConfiguration(name), value_type=str)

    record = ParameterValue(LaunchConfiguration("record"), value_type=bool)
    return LaunchDescription(
        [
            argument("arm", PathJoinSubstitution([config, "paper_arm.yaml"]), "arm YAML: limits, gears, URDF"),
            argument("can", PathJoinSubstitution([config, "paper_arm_can.yaml"]), "CAN YAML: buses and drives"),
            argument("namespace", "", "namespace of all nodes, such as arm_1 where there are two; empty: none"),
            argument("params", PathJoinSubstitution([config, "spacearm.yaml"]), "ROS parameters of all nodes"),
            argument("sim", "true", "whether to start the simulated arm; false: the drives are on the buses"),
            argument("record", "true", "whether to record from the start; false: on /recorder/start"),
            argument("trajectory", "", "excitation file for /excitation/start"),
            node("simulated_arm", IfCondition(LaunchConfiguration("sim")), can_config=text("can")),
            node("canopen_driver", can_config=text("can")),
            node("trajectory", arm=text("arm"), trajectory_file=text("trajectory")),
            node("recorder", start_immediately=record),
            node("identifier", arm=text("arm")),
        ]
    )
