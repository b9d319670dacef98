"""What `colcon test` of an ament package is expected to check, with this package's settings.

ament_flake8 and ament_pep257 come with ROS and are skipped without it; `ruff` checks the same everywhere (ruff.toml).
"""

import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
PLACES = [str(ROOT / name) for name in ("spacearm_ident", "launch", "setup.py")]


@pytest.mark.linter
def test_flake8():
    flake8 = pytest.importorskip("ament_flake8.main", reason="ament_flake8 comes with ROS 2 (ros-jazzy-ament-flake8)")
    code, errors = flake8.main_with_errors(argv=["--config", str(ROOT / "setup.cfg"), *PLACES])
    assert code == 0, "\n".join(errors)


@pytest.mark.linter
def test_pep257():
    pep257 = pytest.importorskip("ament_pep257.main", reason="ament_pep257 comes with ROS 2 (ros-jazzy-ament-pep257)")
    # D105, D107: as in ruff.toml. Without a convention ament's own holds, which wants the first line to be empty.
    words = ["--convention", "google", "--add-ignore", "D105", "D107", "--"]
    assert pep257.main(argv=[*words, str(ROOT / "spacearm_ident")]) == 0


def test_package_xml_names_what_the_package_needs():
    package = ET.parse(ROOT / "package.xml").getroot()
    assert package.get("format") == "3" and package.find("export/build_type").text == "ament_python"
    named = {item.text for tag in ("exec_depend", "test_depend") for item in package.iter(tag)}
    texts = [path.read_text() for folder in ("spacearm_ident", "launch") for path in (ROOT / folder).rglob("*.py")]
    imported = {
        line.split()[1].partition(".")[0]
        for text in texts
        for line in map(str.strip, text.splitlines())
        if line.startswith(("from ", "import ")) and len(line.split()) > 1
    }
    of_ros = {
        name
        for name in imported
        if name.endswith(("_msgs", "_srvs")) or name in ("rclpy", "rcl_interfaces", "launch", "launch_ros")
    }
    assert {"rclpy", "launch", "launch_ros", "sensor_msgs", "std_srvs"} <= of_ros
    assert of_ros <= named, of_ros - named
