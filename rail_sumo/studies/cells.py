"""The files of finished cells: a table, and beside it in the file what it was made of."""

from pathlib import Path

import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from rail_sumo.files import whole_file

MADE_OF = b"rail_sumo"
"""The key of a file's metadata that tells it."""


def made_of(file: Path) -> str:
    """Return what a cell's table was made of; nothing if there is no such file or it is damaged."""
    try:
        return ((pq.read_schema(file).metadata or {}).get(MADE_OF, b"")).decode()
    except (OSError, pa.ArrowException):
        return ""


def write(file: Path, table: pd.DataFrame, made_of: str) -> None:
    """Write a cell's table, whole or not at all, with what it was made of."""
    rows = pa.Table.from_pandas(table, preserve_index=False)
    with whole_file(file) as partial:
        pq.write_table(rows.replace_schema_metadata({MADE_OF: made_of}), partial)
