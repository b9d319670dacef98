"""A bag on disk: one MCAP file or a rosbag2 folder, as streams of raw messages.

Decides which files belong to a path, in which order, and reads them with `McapFile`, or, where they are not MCAP, with
`ros_bags`. Anything that is no bag ends here in one line that says what to do.
"""

from __future__ import annotations

import mmap
import re
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from mcap.writer import MCAP0_MAGIC

from spacearm_ident.documents import file_sha256, parse_yaml, read_text
from spacearm_ident.errors import UserError
from spacearm_ident.recording.contents import Bag, Stream
from spacearm_ident.recording.mcap_reader import Channel, Defect, McapFile, Message, Progress
from spacearm_ident.recording.messages import STATES_TOPIC
from spacearm_ident.recording.recording import Source
from spacearm_ident.recording.ros_bags import is_ros_bag, mcap_files, ros_bag_files, ros_messages
from spacearm_ident.recording.tables import is_log
from spacearm_ident.recording.zstd import ZSTD_MAGIC, ZSTD_SUFFIX, inflate_file, inflated_message

MAX_KEPT_BYTES = 4 * 2**30
"""Most message bytes held at once (three hours of six joints at 1 kHz); beyond it, the bag must be cut."""

_MESSAGE_OVERHEAD = 100  # bytes Python spends on keeping one message, whatever its length


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sort key under which `run_10.mcap` follows `run_9.mcap`."""
    return [(int(part or 0), "") if part.isdigit() else (0, part) for part in re.split(r"(\d+)", path.name)]


def _listed(folder: Path) -> list[str] | None:
    """File names that `metadata.yaml` lists, in order; None when it cannot be used."""
    try:
        text = read_text(folder / "metadata.yaml", "the bag's")
        information = parse_yaml(text, "metadata.yaml")["rosbag2_bagfile_information"]
        names = [Path(str(name)).name for name in information["relative_file_paths"]]
        compression = str(information.get("compression_format") or "zstd").lower()
    except (UserError, ValueError, LookupError, TypeError, AttributeError):
        return None
    if compression != "zstd":
        raise UserError(f"{folder}: compressed by {compression!r}, not zstd; convert it with `ros2 bag convert`")
    return [name.removesuffix(ZSTD_SUFFIX) for name in names]


def bag_files(path: Path) -> tuple[list[Path], list[Defect]]:
    """The files of a bag or log in recorded order, and what is wrong with the folder.

    Raises:
        UserError: There is no such path, or no file of a bag in the folder.
    """
    if is_ros_bag(path):
        return ros_bag_files(path), []
    if is_log(path):
        return (sorted((path / "data").rglob("*.parquet")) if path.is_dir() else [path]), []
    try:
        path.stat()
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: no such file or folder; give an .mcap file or a rosbag2 folder") from error
    if not path.is_dir():
        return [path], []
    found = sorted(mcap_files(path), key=_natural)
    listed = _listed(path)
    if not found:
        raise UserError(f"{path}: no .mcap file in this folder; give an .mcap file or a rosbag2 folder")
    if listed is None:
        if len(found) > 1 and not _parts_of_one(found):
            raise UserError(
                f"{path}: {len(found)} recordings that are not parts of one ({', '.join(f.name for f in found[:3])}"
                f"{', ...' if len(found) > 3 else ''}: they overlap in time, or are not numbered in order of time); "
                f"name them one by one: {path}/*.mcap"
            )
        text = "no usable metadata.yaml (recording not closed?); all .mcap files are read in order of name"
        return found, [Defect("no_metadata", text)]
    present = {file.name.removesuffix(ZSTD_SUFFIX): file for file in found}
    missing = [name for name in listed if name not in present]
    unlisted = [name for name in present if name not in listed]
    defects = []
    if missing:
        text = f"{', '.join(missing)} of metadata.yaml missing in the folder; the rest is read"
        defects.append(Defect("missing_file", text, count=len(missing)))
    if unlisted:
        text = f"{', '.join(unlisted)} not listed in metadata.yaml, not read"
        defects.append(Defect("unlisted_file", text, count=len(unlisted)))
    files = [present[name] for name in dict.fromkeys(listed) if name in present]
    if not files:
        raise UserError(f"{path}: metadata.yaml lists none of the .mcap files there; name one of them")
    return files, defects


def recordings_in(path: Path) -> list[Path]:
    """The bags that a path stands for: itself, or the bags in a folder that is none.

    A folder of unrelated `.mcap` files, or of bag folders, holds several recordings; a rosbag2 folder is one.

    Raises:
        UserError: A bag folder's metadata cannot be used.
    """
    if not path.is_dir() or (path / "metadata.yaml").is_file() or is_log(path) or is_ros_bag(path):
        return [path]
    found = sorted(mcap_files(path), key=_natural)
    if found:
        return [path] if len(found) == 1 or _parts_of_one(found) else found
    inner = [one for one in sorted(path.iterdir(), key=_natural) if one.is_dir() and _holds_a_bag(one)]
    return [bag for one in inner for bag in recordings_in(one)] or [path]


def _holds_a_bag(folder: Path) -> bool:
    return bool(mcap_files(folder)) or is_ros_bag(folder) or is_log(folder)


def _parts_of_one(files: list[Path]) -> bool:
    """Whether files are what a recorder split one recording into: one name, numbered, one after the other in time."""
    numbered = [re.fullmatch(r"(.*)_(\d+)\.mcap", file.name.removesuffix(ZSTD_SUFFIX)) for file in files]
    stems = {match.group(1) for match in numbered if match}
    numbers = [int(match.group(2)) for match in numbered if match]
    if len(numbers) < len(files) or len(stems) > 1 or np.any(np.diff(numbers) < 1):
        return False
    spans = [span for file in files if (span := _span_ns(file)) is not None]
    return all(first[1] <= second[0] for first, second in pairwise(spans))


def _span_ns(file: Path) -> tuple[int, int] | None:
    """First and last log time of a file's joint states, as far as it can be read; None where it cannot or has none."""
    try:
        with _open(file) as data:
            times = [message.log_time_ns for message in McapFile(data, _is_states).messages()]
    except UserError:
        return None
    return (min(times), max(times)) if times else None


def _is_states(channel: Channel) -> bool:
    return channel.topic == STATES_TOPIC


def _open(path: Path) -> mmap.mmap:
    try:
        if not path.is_file():
            raise UserError(f"{path}: neither a file nor a folder of files; give an .mcap file or a rosbag2 folder")
        with path.open("rb") as file:
            head = file.read(16)
            if head.startswith(MCAP0_MAGIC):
                return mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        if head.startswith(ZSTD_MAGIC):
            with tempfile.TemporaryFile(prefix="spacearm_") as plain:
                inflate_file(path, plain)
                plain.seek(0)
                if plain.read(16).startswith(MCAP0_MAGIC):
                    return mmap.mmap(plain.fileno(), 0, access=mmap.ACCESS_READ)
            raise UserError(f"{path}: compressed, but not an MCAP file; `zstd -d` gives what it holds")
    except (OSError, ValueError) as error:
        raise UserError(f"{path}: cannot be read ({error}); check the file and its permissions") from error
    if not head:
        raise UserError(f"{path}: the file is empty; record again or give another file")
    raise UserError(f"{path}: not an MCAP file; give an .mcap file or a rosbag2 folder")


def messages(
    path: str | Path,
    wanted: Callable[[Channel], bool] = lambda _: True,
    *,
    bag: Bag | None = None,
    progress: Progress | None = None,
) -> Iterator[Message]:
    """All sound messages of a bag, file by file in recorded order, inflated.

    Args:
        path: MCAP file or rosbag2 folder.
        wanted: Which channels to yield.
        bag: Filled with topics, defects and sources on the way.
        progress: Told the fraction done.

    Raises:
        UserError: The path is no readable bag.
    """
    bag = bag if bag is not None else Bag()
    if is_ros_bag(Path(path)):
        found = ros_messages(Path(path), wanted, bag, progress)
    else:
        found = _mcap_messages(Path(path), wanted, bag, progress)
    # Without metadata, which a power cut leaves a recording, nothing else says that its messages are compressed.
    for message in found:
        packed = message.payload.startswith(ZSTD_MAGIC)
        yield message._replace(payload=inflated_message(message.payload)) if packed else message


def _mcap_messages(
    path: Path, wanted: Callable[[Channel], bool], bag: Bag, progress: Progress | None
) -> Iterator[Message]:
    files, defects = bag_files(path)
    bag.defects += defects
    total = max(1, sum(file.stat().st_size for file in files))
    done = 0
    for path in files:
        try:
            data = _open(path)
        except UserError as error:
            # The last file of a split recording is empty when the power went as it was opened.
            if len(files) == 1:
                raise
            bag.defects.append(Defect("unreadable_file", f"{error}; not used"))
            continue
        size = path.stat().st_size
        with data:
            file = McapFile(data, wanted)
            for count, message in enumerate(file.messages()):
                if progress is not None and count % 4096 == 0:
                    progress((done + size * file.position / len(data)) / total)
                yield message
            done += size
            name = f"{path.name}: " if len(files) > 1 else ""
            bag.defects += [replace(defect, text=name + defect.text) for defect in file.defects]
            bag.topics |= {channel.topic: channel.type_name for channel in file.channels.values()}
            bag.sources.append(Source(str(path), size, file_sha256(path)))
    if not bag.sources:
        raise UserError(f"{files[0].parent}: none of its .mcap files can be read; record again")
    if progress is not None:
        progress(1.0)


def read_bag(path: str | Path, type_of: Callable[[str], str | None], progress: Progress | None = None) -> Bag:
    """Read topics of a bag into memory.

    Args:
        path: MCAP file or rosbag2 folder.
        type_of: Message type that a topic must have to be read; None: it is not wanted. A topic of another type or
            encoding is left out.
        progress: Told the fraction done.

    Raises:
        UserError: The path is no readable bag, or its messages exceed `MAX_KEPT_BYTES`.
    """

    def wanted(channel: Channel) -> bool:
        # `package/Name` is how converters from ROS 1 write `package/msg/Name`; a damaged file may have lost
        # the type altogether, and the decoder will see.
        expected = type_of(channel.topic)
        names = (expected, expected.replace("/msg/", "/"), "") if expected else ()
        return channel.type_name in names and channel.message_encoding == "cdr"

    bag = Bag()
    room = MAX_KEPT_BYTES
    for message in messages(path, wanted, bag=bag, progress=progress):
        stream = bag.streams.get(message.channel.topic)
        if stream is None:
            stream = bag.streams.setdefault(message.channel.topic, Stream(message.channel))
        stream.log_times_ns.append(message.log_time_ns)
        stream.payloads.append(message.payload)
        room -= len(message.payload) + _MESSAGE_OVERHEAD
        if room < 0:
            raise UserError(f"{path}: more than {MAX_KEPT_BYTES >> 30} GiB of joint data; split it")
    return bag
