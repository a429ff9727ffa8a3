"""Where SUMO's outputs go: those that we ask for to their paths, those of a user's own files to nowhere."""

import os
import re
import shutil
import tempfile
from collections.abc import Iterable, Sequence
from contextlib import suppress
from itertools import pairwise
from pathlib import Path

from rail_sumo.highway.names import OURS

TO_ROOT = "../" * 64
"""From any folder up to the root of the file system, where ".." leads no further."""


class Outputs:
    """A folder in place of those into which a demand's detectors and devices would write, which may be read-only.

    SUMO puts its option `output-prefix` before the last part of each path, as in `detectors/PREFIXe1.xml`; one that
    climbs up to the root takes every file there. In the folder a name is a link to where its content goes. From a path
    of Windows, as `sub\\e1.xml`, nothing climbs: then all outputs are written where they are named, and removed.

    Args:
        outputs: SUMO's options of what is asked for, as on a command line; those whose names end with "output" are
            followed by a path. It is whole once `close` has been called, and not there before.
        unwanted: files, as far as they are known, that nobody reads.
    """

    def __init__(self, outputs: Sequence[str], unwanted: Iterable[Path]) -> None:
        self._folder = Path(tempfile.mkdtemp(prefix=OURS))
        unwanted = set(unwanted)
        self._beside = {path.parent for path in unwanted} if any("\\" in path.name for path in unwanted) else set()
        for name in {path.name for path in unwanted}:
            with suppress(OSError):  # no file can have such a name
                (self._folder / name).symlink_to(os.devnull)
        self._asked = [Path(path).absolute() for option, path in pairwise(outputs) if option.endswith("output")]
        for asked in self._asked:
            link = self._folder / asked.name
            link.unlink(missing_ok=True)
            link.symlink_to(self._partial(asked))

    @property
    def prefix(self) -> str:
        """What SUMO's option `output-prefix` is set to."""
        if self._beside:
            return f"{self._folder.name}_"
        return f"{TO_ROOT}{self._folder.relative_to(self._folder.anchor)}/"

    def close(self) -> None:
        """Put what was asked for in its place; SUMO has closed it."""
        for asked in self._asked:
            if self._partial(asked).exists():
                self._partial(asked).replace(asked)
        self.clear_away()

    def clear_away(self) -> None:
        """Remove what is not whole."""
        for asked in self._asked:
            self._partial(asked).unlink(missing_ok=True)
        for folder in self._beside:
            for unwanted in folder.glob(f"*{self._folder.name}_*"):
                unwanted.unlink(missing_ok=True)
        shutil.rmtree(self._folder, ignore_errors=True)

    def _partial(self, asked: Path) -> Path:
        return asked.with_name(f"{self._folder.name}_{asked.name}")


def without_prefix(text: str) -> str:
    """Return what SUMO says of a file by the name that its user gave it."""
    return re.sub(rf"{re.escape(TO_ROOT)}\S*?/{OURS}[^/]*/", "", text)
