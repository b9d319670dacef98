"""How a result was obtained, for the last section of a page: facts, and files with their checksums."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any, NamedTuple

from ..results.provenance import EPOCH, OPTIONS, RECORDED
from .text import minute, number


class Fact(NamedTuple):
    """A fact of a page's last section.

    Attributes:
        name: What it is about.
        text: The fact.
        verbatim: Whether it is shown as code.
    """

    name: str
    text: str
    verbatim: bool = False


def provenance_facts(known: Mapping[str, Any], files: Mapping[str, str]) -> list[Fact]:
    """What a provenance says, files apart: when runs were recorded, then everything that is not empty.

    Args:
        known: Provenance, as from `provenance`.
        files: Keys of files, as for `source_files`.
    """
    runs = known.get(RECORDED)
    recorded = [Fact("recorded, UTC", "; ".join(map(_when, runs)))] if isinstance(runs, list) else []
    # The command says the options in words.
    others = {key: value for key, value in known.items() if key not in {RECORDED, OPTIONS, *files} and value}
    return recorded + [
        Fact(str(key).replace("_", " "), _text(value), not isinstance(value, (Mapping, float)))
        for key, value in others.items()
    ]


def source_files(known: Mapping[str, Any], files: Mapping[str, str]) -> list[tuple[str, list[dict[str, Any]]]]:
    """Titles, each with the path, size and checksum of its files; no files where the provenance does not say.

    Args:
        known: Provenance, as from `provenance`.
        files: Key of the provenance -> title.
    """
    return [
        (
            title,
            [
                {name: source.get(name, "") for name in ("path", "bytes", "sha256")}
                for source in known.get(key) or ()
                if isinstance(source, Mapping)
            ],
        )
        for key, title in files.items()
    ]


def _when(run: Any) -> str:
    """Start and length of a run, and how warm its joints were."""
    known = run if isinstance(run, Mapping) else {}
    start = str(known.get("start", ""))
    try:
        when = "no date" if datetime.fromisoformat(start).astimezone(UTC) < EPOCH else minute(start)
    except ValueError:
        when = minute(start)
    text = f"{when}, {_plain(known.get('duration_s', ''))} s"
    warm = known.get("temperature_C")
    return text + (f" at {_text(warm)} °C" if isinstance(warm, Mapping) else "")


def _text(value: Any) -> str:
    """A value of the provenance: the items of a mapping one after the other, numbers as a person writes them."""
    if isinstance(value, Mapping):
        return ", ".join(f"{key} {_plain(item)}" for key, item in value.items())
    return number(value, 4) if isinstance(value, float) else str(value)


def _plain(value: Any) -> str:
    """A value inside a sentence: numbers as a person writes them, mappings and lists without their brackets."""
    if isinstance(value, Mapping):
        return " ".join(f"{key} {_plain(item)}" for key, item in value.items())
    if isinstance(value, (list, tuple)):
        return " ".join(map(_plain, value))
    return number(value, 4) if isinstance(value, float) else str(value)
