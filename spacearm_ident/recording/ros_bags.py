"""Bags that are not MCAP: rosbag2 in sqlite3 (`.db3`, compressed or not) and ROS 1 (`.bag`), through `rosbags`.

Their messages come out as those of an MCAP bag do, raw and in CDR, so that everything behind works alike. A ROS 1
message of a type that a recording is made of is decoded and encoded again; any other is not read.
"""

from __future__ import annotations

import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np

from spacearm_ident.documents import file_sha256, parse_yaml, read_text
from spacearm_ident.errors import UserError
from spacearm_ident.recording import cdr, messages
from spacearm_ident.recording.contents import Bag
from spacearm_ident.recording.mcap_reader import Channel, Defect, Message, Progress
from spacearm_ident.recording.recording import Source
from spacearm_ident.recording.tables.optional import optional
from spacearm_ident.recording.zstd import ZSTD_SUFFIX, inflate_file

_DB3, _ROS1 = ".db3", ".bag"
_SQLITE, _ROS1_MAGIC = b"SQLite format 3", b"#ROSBAG"


def mcap_files(folder: Path) -> list[Path]:
    """The MCAP files of a folder, compressed ones among them unless they lie beside what they hold."""
    plain = list(folder.glob("*.mcap"))
    return plain + [file for file in folder.glob(f"*.mcap{ZSTD_SUFFIX}") if file.with_suffix("") not in plain]


def is_mcap(path: Path) -> bool:
    """Whether the name of a file is that of an MCAP file, compressed or not."""
    return path.name.removesuffix(ZSTD_SUFFIX).endswith(".mcap")


def is_ros_bag(path: Path) -> bool:
    """Whether a path is a bag in sqlite3 or of ROS 1: a file by its first bytes or suffix, a folder by its files."""
    if path.is_dir():
        return bool(_db3_files(path)) and not mcap_files(path)
    try:
        # A pipe would be waited for.
        if not path.is_file() or path.name.endswith((_DB3, _DB3 + ZSTD_SUFFIX, _ROS1)):
            return path.is_file()
        with path.open("rb") as file:
            return file.read(16).startswith((_SQLITE, _ROS1_MAGIC))
    except (OSError, ValueError):
        return False


def ros_bag_files(path: Path) -> list[Path]:
    """The files of such a bag, in recorded order where `metadata.yaml` tells it."""
    if not path.is_dir():
        return [path]
    found = _db3_files(path)
    listed = [str(name).rpartition("/")[2] for name in _metadata(path).get("relative_file_paths") or ()]
    in_order = [file for name in listed for file in found if file.name in (name, name + ZSTD_SUFFIX)]
    return in_order or found


def _db3_files(folder: Path) -> list[Path]:
    return sorted([*folder.glob(f"*{_DB3}"), *folder.glob(f"*{_DB3}{ZSTD_SUFFIX}")])


def _metadata(folder: Path) -> dict[str, Any]:
    """What `metadata.yaml` says of the bag; nothing where it cannot be used."""
    try:
        data = parse_yaml(read_text(folder / "metadata.yaml", "the bag's"), "metadata.yaml")
        information = data["rosbag2_bagfile_information"]
    except (UserError, LookupError, TypeError):
        return {}
    return information if isinstance(information, dict) else {}


def ros_messages(
    path: Path, wanted: Callable[[Channel], bool], bag: Bag, progress: Progress | None = None
) -> Iterator[Message]:
    """All messages of wanted topics, file by file in recorded order.

    Args:
        path: The bag.
        wanted: Which channels to yield.
        bag: Filled with topics, defects and sources on the way.
        progress: Told the fraction done.

    Raises:
        UserError: rosbags is missing, or the bag cannot be read.
    """
    optional("rosbags", "rosbags", "reading sqlite3 and ROS 1 bags")
    files = ros_bag_files(path)
    for number, file in enumerate(files):
        if progress is not None:
            progress(number / len(files))
        try:
            bag.sources.append(Source(str(file), file.stat().st_size, file_sha256(file)))
        except OSError as error:
            raise UserError(f"{file}: cannot be read ({error.strerror}); check the file") from error
        yield from _ros1(file, wanted, bag) if _is_ros1(file) else _sqlite(file, wanted, bag)
    if progress is not None:
        progress(1.0)


def _is_ros1(file: Path) -> bool:
    with file.open("rb") as stream:
        return stream.read(16).startswith(_ROS1_MAGIC)


def _sqlite(file: Path, wanted: Callable[[Channel], bool], bag: Bag) -> Iterator[Message]:
    """Messages of one sqlite3 file; what follows a damaged page is lost, and reported."""
    from rosbags.rosbag2.errors import ReaderError
    from rosbags.rosbag2.storage_sqlite3 import Sqlite3Reader

    last: int | None = None
    with ExitStack() as stack:
        place = _inflated(file, stack) if file.name.endswith(ZSTD_SUFFIX) else file
        _require_tables(place, file)
        try:
            # Characters that mean something in a URI would name another file.
            if any(character in str(place) for character in "?#%"):
                place = _linked(place, stack)
            reader = Sqlite3Reader(place)
            reader.open()
            stack.callback(reader.close)
            channels = {one.id: _channel(one.topic, one.msgtype) for one in reader.connections}
            bag.topics |= {channel.topic: channel.type_name for channel in channels.values()}
            chosen = [one for one in reader.connections if wanted(channels[one.id])]
            for one, stamp, data in reader.messages(chosen) if chosen else ():
                last = max(0, int(stamp))
                yield Message(channels[one.id], last, last, bytes(data))
        except (UserError, GeneratorExit):
            raise
        except ReaderError as error:
            raise UserError(f"{file}: not a readable rosbag2 file ({error}); record again or convert it") from error
        except Exception as error:  # apsw raises some thirty classes of its own
            if last is None:
                raise UserError(f"{file}: damaged ({type(error).__name__}: {error}); record again") from error
            bag.defects.append(Defect("cut_off", f"{file.name} is damaged ({error}); the rest is lost", last))


def _require_tables(place: Path, file: Path) -> None:
    """Refuse what is no bag, with views or triggers in place of tables: they would run what the file says."""
    try:
        with closing(sqlite3.connect(f"{place.resolve().as_uri()}?mode=ro&immutable=1", uri=True)) as connection:
            kinds = dict(
                connection.execute("SELECT name, type FROM sqlite_master WHERE name IN ('messages', 'topics')")
            )
            odd = connection.execute("SELECT count(*) FROM sqlite_master WHERE type IN ('view', 'trigger')").fetchone()
    except (sqlite3.Error, ValueError, OverflowError) as error:
        raise UserError(f"{file}: not a readable rosbag2 file ({error}); record again or give another file") from error
    if kinds != {"messages": "table", "topics": "table"} or odd != (0,):
        raise UserError(f"{file}: not a bag: it has no tables 'messages' and 'topics'; give a rosbag2 file")


def _linked(place: Path, stack: ExitStack) -> Path:
    folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="spacearm_")))
    link = folder / "bag.db3"
    link.symlink_to(place.resolve())
    return link


def _inflated(file: Path, stack: ExitStack) -> Path:
    """A compressed file, inflated beside nothing that stays."""
    place = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="spacearm_"))) / "bag.db3"
    with place.open("wb") as target:
        inflate_file(file, target)
    return place


def _channel(topic: str, kind: str) -> Channel:
    return Channel(topic, kind, "", b"", "cdr", {})


def _ros1(file: Path, wanted: Callable[[Channel], bool], bag: Bag) -> Iterator[Message]:
    """Messages of one ROS 1 file, in CDR."""
    from rosbags.rosbag1 import Reader
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS1_NOETIC)
    last: int | None = None
    unreadable = 0
    try:
        with Reader(file) as reader:
            channels = {one.id: _channel(one.topic, one.msgtype) for one in reader.connections}
            bag.topics |= {channel.topic: channel.type_name for channel in channels.values()}
            chosen = [one for one in reader.connections if one.msgtype in _ENCODERS and wanted(channels[one.id])]
            for one, stamp, data in reader.messages(chosen) if chosen else ():
                last = max(0, int(stamp))
                try:
                    payload = _ENCODERS[one.msgtype](store.deserialize_ros1(data, one.msgtype))
                except Exception:  # whatever a damaged message makes numpy and struct raise
                    unreadable += 1
                    continue
                yield Message(channels[one.id], last, last, payload)
    except GeneratorExit:
        raise
    except Exception as error:  # damaged indices make rosbags raise of everything
        if last is None:
            raise UserError(f"{file}: not a readable ROS 1 bag ({error}); try `rosbag reindex` on it") from error
        bag.defects.append(Defect("cut_off", f"{file.name} is damaged ({error}); the rest is lost", last))
    if unreadable:
        bag.defects.append(Defect("undecodable_message", f"{unreadable} messages left out", last, unreadable))


def _stamp_ns(message: Any) -> int:
    return int(message.header.stamp.sec) * 10**9 + int(message.header.stamp.nanosec)


def _joint_state(message: Any) -> bytes:
    """A joint state in CDR; a signal that is not one number a joint is left out, as on reading."""
    names = [str(name) for name in message.name]

    def row(values: Any) -> Any:
        return np.asarray(values, dtype=np.float64)[None] if len(values) == len(names) else None

    position = row(message.position)
    if position is None:
        raise ValueError("a joint state without positions")
    return cdr.encode_joint_states([_stamp_ns(message)], names, position, row(message.velocity), row(message.effort))[0]


_ENCODERS: dict[str, Callable[[Any], bytes]] = {
    messages.JOINT_STATE.name: _joint_state,
    messages.STRING.name: lambda message: cdr.encode_string(str(message.data)),
    messages.TEMPERATURE.name: lambda message: cdr.encode_temperature(
        _stamp_ns(message), str(message.header.frame_id), float(message.temperature)
    ),
}
"""Type -> a ROS 1 message of it in CDR."""
