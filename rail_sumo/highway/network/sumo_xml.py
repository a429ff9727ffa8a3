"""SUMO's files: XML, plain or compressed, and how they write times."""

import gzip
import xml.etree.ElementTree as ElementTree
import xml.sax
import zlib
from collections.abc import Iterable
from io import BufferedIOBase
from pathlib import Path

UNREADABLE = (xml.sax.SAXParseException, ElementTree.ParseError, zlib.error, EOFError, OSError)
"""What reading a file raises that is damaged, or no XML."""
UNKNOWN_ENCODING = (LookupError, ValueError)
"""What ElementTree raises at an encoding that it does not know."""

_SIZES_S = (1.0, 60.0, 3600.0, 86400.0)


GZIP = b"\x1f\x8b"
"""What a compressed file begins with, whatever it is called."""


def opened(path: Path) -> BufferedIOBase:
    """Open a file, compressed or not."""
    with path.open("rb") as stream:
        is_compressed = stream.read(len(GZIP)) == GZIP
    return gzip.open(path) if is_compressed else path.open("rb")


def root_of(path: Path) -> ElementTree.Element:
    """Return a file's outermost element, with its attributes and nothing in it."""
    with opened(path) as stream:
        _, root = next(ElementTree.iterparse(stream, events=("start",)))
    return root


def first_damaged(files: Iterable[Path]) -> Path | None:
    """Return the first of some files that is no whole XML, if any is."""
    for file in files:
        try:
            with opened(file) as stream:
                xml.sax.parse(stream, xml.sax.ContentHandler())
        except (*UNREADABLE, *UNKNOWN_ENCODING):
            return file
    return None


def is_configuration(path: Path) -> bool:
    """Return whether a file is a configuration of SUMO's, by what its root element is called."""
    try:
        return "config" in root_of(path).tag.lower()
    except (*UNREADABLE, *UNKNOWN_ENCODING):
        return False


def state_of(path: Path) -> tuple[int, int]:
    """Return what changes when somebody edits a file; what was read of it is kept until then."""
    found = path.stat()
    return found.st_mtime_ns, found.st_size


def seconds(time: str) -> float:
    """Return a time as SUMO writes it, "90", "0:01:30" or "0:00:01:30", in seconds.

    Raises:
        ValueError: it is none.
    """
    parts = [float(part) for part in reversed(time.split(":"))]
    return sum(part * size for part, size in zip(parts, _SIZES_S[: len(parts)], strict=True))
