"""What the runs of a sweep tell against its own figures: vehicles that wait, a road that fills up, one that locks."""

from collections.abc import Iterator

import pandas as pd

from rail_sumo.tables import shares

MOST_TOLD = 4
"""A note names so many groups of runs at most."""
GROWN, GROWN_BY = 10.0, 0.2
"""A road fills up where there are so many vehicles more at the end of the period, and by this share of those before."""


def of_runs(table: pd.DataFrame) -> Iterator[str]:
    """Yield a note for each of what follows that the runs show, given as `TRAFFIC_COLUMNS`."""
    yield from backlog(table)
    yield from growth(table)
    yield from locks(table)


def backlog(table: pd.DataFrame) -> Iterator[str]:
    """Tell where vehicles found no room to enter, which no mean of those on the road shows."""
    waiting = shares.of_all_vehicles(table).groupby(shares.ARM)["waiting"].mean()
    if waiting.max() >= 1.0:
        yield (
            f"vehicles still wait for room to enter at the end, {waiting.min():.0f} to {waiting.max():.0f} of them in "
            f"the mean over seeds (column waiting): where that differs, speeds are of different traffic"
        )


def growth(table: pd.DataFrame) -> Iterator[str]:
    """Tell where more vehicles came than left, so that the figures depend on when the period begins and ends."""
    on_road = shares.of_all_vehicles(table).groupby(shares.ARM)[["unfinished", "inserted", "arrived"]].mean()
    ends = on_road["unfinished"]
    begins = ends - on_road["inserted"] + on_road["arrived"]
    growth = ends - begins
    grown = growth[(growth >= GROWN) & (growth > GROWN_BY * begins)].sort_values(ascending=False)
    if len(grown):
        told = [f"{shares.called(*arm)} from {begins[arm]:.0f} to {ends[arm]:.0f}" for arm in grown.index[:MOST_TOLD]]
        more = f" and {len(grown) - MOST_TOLD} more" if len(grown) > MOST_TOLD else ""
        yield (
            f"the road fills up in the period, by vehicles in the mean over seeds: {'; '.join(told)}{more}: figures "
            "depend on when it begins and ends"
        )


def locks(table: pd.DataFrame) -> Iterator[str]:
    """Tell where SUMO took vehicles off the road that had stood for too long, as where it is locked."""
    locked = shares.of_all_vehicles(table).query("teleports > 0")
    if len(locked):
        told = [
            f"{shares.called(driver, setting, share)} {', '.join(map(str, of_arm['seed']))}"
            for (driver, setting, share), of_arm in locked.groupby(shares.ARM, sort=False)
        ]
        more = f" and {len(told) - MOST_TOLD} more" if len(told) > MOST_TOLD else ""
        yield (
            f"SUMO took vehicles off the road that had stood too long (column teleports), with the seeds "
            f"{'; '.join(told[:MOST_TOLD])}{more}: the road may be locked there, and means are of unlike runs"
        )
