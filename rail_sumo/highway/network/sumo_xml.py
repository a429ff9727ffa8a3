"""SUMO's files: XML, plain or compressed, and how they write times."""

import gzip
import xml.etree.ElementTree as ElementTree
import xml.sax
import zlib
from collections.abc import Iterable, Iterator
from io import BufferedIOBase
from pathlib import Path

from rail_sumo.errors import InputError

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


DEEPEST = 100
"""So many elements may lie within one another. SUMO's own files have less than ten, and the time it takes to read them
grows with the square of it."""


def root_of(path: Path) -> ElementTree.Element:
    """Return a file's outermost element, with its attributes and nothing in it."""
    with opened(path) as stream:
        _, root = next(ElementTree.iterparse(stream, events=("start",)))
    return root


def elements(path: Path) -> Iterator[ElementTree.Element]:
    """Yield a file's elements as they end, each with what is in it, which is forgotten afterwards.

    Raises:
        InputError: it is no whole XML, or nests deeper than any of SUMO's files.
    """
    depth = 0
    try:
        with opened(path) as stream:
            for event, element in ElementTree.iterparse(stream, events=("start", "end")):
                if event == "start":
                    depth += 1
                    require_flat(path, depth)
                else:
                    depth -= 1
                    yield element
                    element.clear()
    except InputError:
        raise
    except (*UNREADABLE, *UNKNOWN_ENCODING) as error:
        raise InputError(f"'{path}' is not a complete XML file: {getattr(error, 'strerror', '') or error}") from None


def require_flat(path: Path, depth: int) -> None:
    """Raise InputError if elements lie so deep in one another as in no file of SUMO's."""
    if depth > DEEPEST:
        raise InputError(f"'{path}' has elements within one another, more than {DEEPEST} deep; SUMO's files have a few")


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
