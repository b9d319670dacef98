"""What rosbag2 compresses with zstd, whole files or each message, inflated within `MAX_INFLATED` times its size."""

from __future__ import annotations

from pathlib import Path
from typing import BinaryIO

import zstandard

from spacearm_ident.errors import UserError

ZSTD_SUFFIX = ".zstd"
"""rosbag2 writes `run_0.mcap.zstd` for `run_0.mcap`."""
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""How zstd data begin; a CDR payload begins with a zero."""
MAX_INFLATED = 64
"""Most a compressed file or message may grow by (and 1 MiB): joint states shrink to a third or so."""


def inflate_file(file: Path, target: BinaryIO) -> None:
    """Write what a compressed file holds; of one that breaks off, what is before that.

    Args:
        file: The compressed file.
        target: Where its content is written.

    Raises:
        UserError: It is damaged, or grows beyond `MAX_INFLATED`.
    """
    room = MAX_INFLATED * file.stat().st_size + 2**20
    try:
        with file.open("rb") as packed:
            reader = zstandard.ZstdDecompressor().stream_reader(packed, read_across_frames=True)
            while piece := reader.read(2**20):
                room -= len(piece)
                if room < 0:
                    raise UserError(f"{file}: grows by more than {MAX_INFLATED} times; decompress it (`zstd -d`) first")
                target.write(piece)
    except (zstandard.ZstdError, OSError) as error:
        raise UserError(f"{file}: cannot be decompressed ({error}); try `zstd -d`, or record again") from error


def inflated_message(data: bytes) -> bytes:
    """A compressed message, inflated; as it is where it cannot be, and no decoder takes that for a message."""
    room = MAX_INFLATED * len(data) + 2**20
    try:
        reader = zstandard.ZstdDecompressor().stream_reader(data, read_across_frames=True)
        plain = bytes(reader.read(room + 1))
    except zstandard.ZstdError:
        return data
    return data if len(plain) > room else plain
