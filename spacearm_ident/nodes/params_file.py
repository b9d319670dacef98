"""Parameter files that hold in any namespace.

In a parameter file a node is meant by its full name, `/arm_1/recorder:`, or, in C++, by a pattern such as
`/**/recorder:`. rclpy of Jazzy knows no pattern but `/**`, and passes over a plain `recorder:` without a word as soon
as the node is in a namespace: an arm would run with another one's settings. So here the plain name of one of this
package's nodes means that node in whatever namespace it is started; where the file has its full name as well, that
alone counts.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Final

from .main import NODES

_NAMESPACE: Final = re.compile(r"(?:\w+:)?__ns:=(\S+)")
_PLAIN: Final = re.compile(rf"^(['\"]?)({'|'.join(NODES)})\1(?=\s*:)", re.MULTILINE)


@contextmanager
def holding_in_namespace(arguments: Sequence[str]) -> Iterator[list[str]]:
    """The same arguments, with parameter files that name the nodes in full where a namespace is given.

    The files are gone at the end of the context; `rclpy.init` reads them at once.

    Args:
        arguments: Command line, such as `--ros-args -r __ns:=/arm_1 --params-file FILE`.
    """
    words = list(arguments)
    given = [match[1].strip("/") for word in words if (match := _NAMESPACE.fullmatch(word))]
    # The first of several rules is the one that ROS takes. `__ns:=/` is none: launch_ros says so for an empty one.
    if not given or not given[0]:
        yield words
        return
    namespace = f"/{given[0]}"
    with tempfile.TemporaryDirectory(prefix="spacearm-params-") as folder:
        for place, word in enumerate(words[:-1], start=1):
            file = Path(words[place])
            if word == "--params-file" and file.is_file():
                # The name stays: it is in what rcl says of a file that it cannot read.
                changed = Path(folder, str(place), file.name)
                changed.parent.mkdir()
                changed.write_text(name_in_full(file.read_text(), namespace))
                words[place] = str(changed)
        yield words


def name_in_full(text: str, namespace: str) -> str:
    """The text of a parameter file with this package's nodes named in full.

    The text is not parsed: what is written stays as it is written, for rcl's YAML is not Python's.

    Args:
        text: YAML, with the nodes as its outermost keys.
        namespace: Such as `/arm_1`.
    """

    def full(match: re.Match[str]) -> str:
        name = f"{namespace}/{match[2]}"
        return match[0] if re.search(rf"^['\"]?{re.escape(name)}['\"]?\s*:", text, re.MULTILINE) else name

    return _PLAIN.sub(full, text)
