"""Text that others wrote: files of a bounded size, YAML that does not expand, XML without a document type.

What is read here may be hostile. It ends in plain data or in a `UserError`; it runs nothing, fetches nothing, and
takes time and memory in proportion to its size.
"""

from __future__ import annotations

import hashlib
import math
import os
import stat
import xml.etree.ElementTree as ET
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any
from xml.parsers.expat import ExpatError, ParserCreate

import yaml

from .errors import UserError

MAX_BYTES = 16 * 2**20
"""Largest file read; a URDF of a robot has some 100 kB."""
MAX_VALUES = 200_000
"""Most values in a YAML document, each alias counted as all it stands for."""
MAX_DEPTH = 60
"""Deepest nesting: the parsers behind this recurse, and one of them crashes where another raises."""
MAX_SCALAR = 100
"""Longest plain number or date: PyYAML's base-60 numbers take quadratic time."""
MAX_ELEMENTS = 100_000
"""Most elements of an XML document."""

# libyaml's is ten times faster; without it PyYAML has no such class.
_Loader: type[yaml.SafeLoader] = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_PLAIN = frozenset({"null", "bool", "int", "float", "timestamp", "merge", "value"})


def read_text(path: Path, what: str) -> str:
    """The text of a regular file (UTF-8) of at most `MAX_BYTES`.

    Args:
        path: The file.
        what: What it is to the user, for the error: `the arm`.

    Raises:
        UserError: It is not there, is a pipe or a device, too large, or not text.
    """
    try:
        found = path.stat()
        if not stat.S_ISREG(found.st_mode):
            raise UserError(f"cannot read {what} {path}: it is not a regular file; name one")
        if found.st_size > MAX_BYTES:
            raise UserError(
                f"cannot read {what} {path}: {found.st_size} bytes, more than {MAX_BYTES}; is it that file?"
            )
        return path.read_text(encoding="utf-8")
    except (OSError, ValueError) as error:  # ValueError: not UTF-8, or a NUL in the path
        reason = getattr(error, "strerror", None) or str(error)
        raise UserError(f"cannot read {what} {path} ({reason}): check the path") from error


def try_folder(directory: Path) -> None:
    """Find out whether files can be written to a folder, which need not be there yet; leaves nothing behind.

    Args:
        directory: The folder; made, with those around it, for the trial.

    Raises:
        OSError: It is no folder, cannot be made, or no file can be made in it.
    """
    made: list[Path] = []
    try:
        for folder in (*reversed(directory.parents), directory):
            if not folder.exists():
                folder.mkdir(exist_ok=True)
                made.append(folder)
        with TemporaryFile(dir=directory):
            pass
    finally:
        for folder in reversed(made):
            # Not empty: another process has written there meanwhile.
            with suppress(OSError):
                folder.rmdir()


def write_whole(path: Path, text: str) -> None:
    """Write a file that is there whole or not at all: what was there before stays until then.

    Args:
        path: The file.
        text: All of it.

    Raises:
        OSError: It cannot be written.
    """
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        part.write_text(text, encoding="utf-8")
        os.replace(part, path)
    finally:
        part.unlink(missing_ok=True)


def file_sha256(path: Path) -> str:
    """SHA-256 of a file's bytes, in hexadecimal."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def finite(value: float) -> float | None:
    """A plain float, or None for NaN and infinities, which JSON does not have."""
    return float(value) if math.isfinite(value) else None


def entries(value: Any, where: str) -> Mapping[Any, Any]:
    """A mapping of a document, or an empty one where nothing is given.

    Args:
        value: What the document has there.
        where: The file and key, for the error.

    Raises:
        UserError: It is no mapping.
    """
    if value is None:
        return {}
    if not isinstance(value, dict):
        raise UserError(f"{where} needs 'key: value' pairs, not {value!r}")
    return value


def read_yaml(path: Path, what: str) -> Any:
    """The document in a YAML file, as plain data.

    Args:
        path: The file.
        what: What it is, for errors.

    Raises:
        UserError: As `read_text` and `parse_yaml`.
    """
    return parse_yaml(read_text(path, what), str(path))


def parse_yaml(text: str | bytes, where: str) -> Any:
    """A YAML document as plain data; `where` names it in errors.

    Args:
        text: The document.
        where: Its name in errors.

    Raises:
        UserError: Not valid YAML, nested deeper than `MAX_DEPTH`, more than `MAX_VALUES` values, or one that holds
            itself.
    """
    try:
        _measure(text, where)
        return yaml.load(text, _Loader)
    except yaml.YAMLError as error:
        raise UserError(f"{where} is not valid YAML ({' '.join(str(error).split())}): correct it there") from error
    # Tags that do not fit their text (`!!int x`, a 13th month) leave PyYAML as whatever went wrong inside it.
    except (ValueError, ArithmeticError, LookupError, TypeError, AttributeError, RecursionError) as error:
        raise UserError(f"{where} is not valid YAML ({type(error).__name__}: {error}): correct it there") from error


def _measure(text: str | bytes, where: str) -> None:
    """Refuse what would expand or overflow a stack, from the events alone: they cost no memory and no recursion."""
    sizes: dict[str, int | None] = {}  # by anchor; None while it is still open
    open_nodes: list[tuple[str | None, int]] = []
    total = 0
    for event in yaml.parse(text, _Loader):
        anchor = getattr(event, "anchor", None)
        if isinstance(event, yaml.CollectionEndEvent):
            name, before = open_nodes.pop()
            if name is not None:
                sizes[name] = total - before
            continue
        if isinstance(event, yaml.AliasEvent):
            size = sizes.get(str(anchor), 1)
            if size is None:
                raise UserError(f"{where}: {anchor!r} contains itself: write out what it stands for")
            total += size
        elif isinstance(event, yaml.NodeEvent):
            total += 1
            if anchor is not None:
                sizes[anchor] = None if isinstance(event, yaml.CollectionStartEvent) else 1
            if isinstance(event, yaml.CollectionStartEvent):
                open_nodes.append((anchor, total - 1))
            elif isinstance(event, yaml.ScalarEvent) and len(event.value) > MAX_SCALAR:
                _refuse_long(event, where)
        if total > MAX_VALUES or len(open_nodes) > MAX_DEPTH:
            most = f"{MAX_VALUES} values" if total > MAX_VALUES else f"{MAX_DEPTH} levels"
            raise UserError(f"{where} has more than {most}, its aliases written out: cut it down")


def _refuse_long(event: yaml.ScalarEvent, where: str) -> None:
    tag = event.tag or (_RESOLVER.resolve(yaml.ScalarNode, event.value, event.implicit) if event.implicit[0] else "")
    if tag.rpartition(":")[2] in _PLAIN:
        raise UserError(f"{where}: a number of {len(event.value)} characters: shorten it")


_RESOLVER = yaml.resolver.Resolver()


def check_xml(text: str, what: str, on_element: Callable[[int, str, dict[str, str]], object] | None = None) -> None:
    """Pass over an XML document; namespaces are left alone, as robots' parsers do.

    Args:
        text: The document.
        what: What it is, for the error: `the URDF`.
        on_element: Told the depth (1: the root), the name and the attributes of each element.

    Raises:
        UserError: Not well-formed, a document type (with it entities could expand or be fetched), more than
            `MAX_ELEMENTS` elements, or nested deeper than `MAX_DEPTH`.
    """
    depth = count = 0

    def doctype(*_: object) -> None:
        raise UserError(f"{what} has a DOCTYPE: take it and its entities out (xacro does that)")

    def start(name: str, attributes: dict[str, str]) -> None:
        nonlocal depth, count
        depth, count = depth + 1, count + 1
        if depth > MAX_DEPTH or count > MAX_ELEMENTS:
            raise UserError(f"{what} has more than {MAX_ELEMENTS} elements or {MAX_DEPTH} levels: is it that file?")
        if on_element is not None:
            on_element(depth, name, attributes)

    def end(_: str) -> None:
        nonlocal depth
        depth -= 1

    if len(text) > MAX_BYTES:
        raise UserError(f"{what} has more than {MAX_BYTES} characters: is it that file?")
    parser = ParserCreate("utf-8")
    parser.StartDoctypeDeclHandler = doctype
    parser.StartElementHandler = start
    parser.EndElementHandler = end
    try:
        parser.Parse(text.strip().encode(), True)
    except (ExpatError, UnicodeEncodeError) as error:
        raise UserError(f"{what} is not well-formed XML ({error}): mend it, or export it again") from error


def parse_xml(text: str, what: str, *, comments: bool = False) -> ET.Element:
    """The root of an XML document that `check_xml` passes; names with a prefix stay as they are written.

    Args:
        text: The document.
        what: Its name in errors.
        comments: Whether comments and processing instructions inside the root stay in the tree.

    Raises:
        UserError: As `check_xml`.
    """
    check_xml(text, what)
    builder = ET.TreeBuilder(insert_comments=comments, insert_pis=comments)
    parser = ParserCreate("utf-8")
    if comments:
        parser.CommentHandler = builder.comment
        parser.ProcessingInstructionHandler = builder.pi
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.CharacterDataHandler = builder.data
    parser.Parse(text.strip().encode(), True)
    return builder.close()
