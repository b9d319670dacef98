"""Bags and tables in and out: files to arrays (`Recording`) and back."""

from spacearm_ident.recording.bag import recordings_in
from spacearm_ident.recording.reader import describe, read_recording
from spacearm_ident.recording.recording import BaseSensor, Issue, Recording, Series, Source
from spacearm_ident.recording.writer import RecordingWriter, copy_messages, write_recording

__all__ = [
    "BaseSensor",
    "Issue",
    "Recording",
    "RecordingWriter",
    "Series",
    "Source",
    "copy_messages",
    "describe",
    "read_recording",
    "recordings_in",
    "write_recording",
]
