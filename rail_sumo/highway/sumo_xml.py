"""SUMO's files: XML, plain or compressed."""

import gzip
import xml.etree.ElementTree as ElementTree
import xml.sax
import zlib
from io import BufferedIOBase
from pathlib import Path

UNREADABLE = (xml.sax.SAXParseException, ElementTree.ParseError, zlib.error, EOFError, OSError)
"""What reading a file raises that is damaged, or no XML."""


def opened(path: Path) -> BufferedIOBase:
    """Open a file as SUMO does: compressed if it is called so."""
    return gzip.open(path) if path.suffix == ".gz" else path.open("rb")


def state_of(path: Path) -> tuple[int, int]:
    """Return what changes when somebody edits a file; what was read of it is kept until then."""
    found = path.stat()
    return found.st_mtime_ns, found.st_size
