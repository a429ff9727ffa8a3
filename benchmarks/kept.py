"""Long work in parts, each of which is done once: what was interrupted goes on by the same command."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pandas as pd

from rail_sumo import rollout
from rail_sumo.files import whole_file


def tables(
    out: Path, parts: Mapping[str, Any], do: Callable[[Any], pd.DataFrame], *, workers: int, say: Callable[..., str]
) -> pd.DataFrame:
    """Return the tables that `do` makes of all parts, end to end; those under their names in `out` are read from there.

    Args:
        out: where to keep them, as CSV.
        parts: what `do` takes, by a name that tells all that the table depends on.
        do: runs in a process of its own.
        workers: how many of these.
        say: a part's table -> what to print when it is done.
    """
    out.mkdir(parents=True, exist_ok=True)
    files = {name: out / f"{name}.csv" for name in parts}
    missing = [name for name, file in files.items() if not file.exists()]
    with rollout.workers(workers) as pool:
        for name, table in zip(missing, pool.map(do, [parts[name] for name in missing]), strict=True):
            with whole_file(files[name]) as part:
                table.to_csv(part, index=False)
            print(f"{name}: {say(table)}", flush=True)
    return pd.concat([pd.read_csv(file) for file in files.values()], ignore_index=True)
