"""One page about runs, evaluations, sweeps and studies: what was run, with which figures and pictures."""

import html
import json
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import pandas as pd

from rail_sumo import assets, config_file
from rail_sumo.config import Config, flat
from rail_sumo.errors import InputError
from rail_sumo.files import check_file, whole_file
from rail_sumo.pictures import markup, plot, plot_episodes
from rail_sumo.records import MetaAction
from rail_sumo.run_directory import CLONE, CONFIG, PROGRESS, RunDirectory
from rail_sumo.tables import report
from rail_sumo.tables.report import CONTACTS, DECISIONS, EPISODES, ORIGIN, SUMMARY, WORLD
from rail_sumo.tables.shares import ARM, EDGES, HEADINGS, TOLD, called, rates
from rail_sumo.tables.traffic import ALL

_PARTS = Path(__file__).with_name("report")

CELLS, TRAFFIC, DIFFERENCES = "cells.parquet", "traffic.parquet", "differences.parquet"
TABLE1, TABLE1_TOLD, SWEEP = "table1.csv", "table1.md", "sweep.md"
KINDS = {CONFIG: "run", EPISODES: "evaluation", CELLS: "study", TRAFFIC: "sweep"}
"""What a folder is, by the first of these files that it has."""

MOST_EDGES = 10
"""So many edges are shown of a sweep."""
ACTIONS = [action.name.lower() for action in MetaAction]


def write(folders: Sequence[Path], out: Path, *, overwrite: bool = False) -> None:
    """Write one page about folders that `train`, `eval`, `expert train`, `sweep` or `reproduce` has written.

    Args:
        folders: one section each, in this order.
        out: the page, .html. It holds its pictures and fetches nothing.
        overwrite: whether `out` may exist.

    Raises:
        InputError: matplotlib is not installed; a folder that is none of these, or is damaged; a page that exists or
            cannot be written.
    """
    plot.require_matplotlib()
    titles = _titles(folders)
    check_file(out, overwrite=overwrite)
    sections = [(title, "\n".join(_about(folder))) for title, folder in zip(titles, folders, strict=True)]
    settings = _settings(folders)
    if settings:
        sections.append(("Configuration", settings))
    page = Template((_PARTS / "page.html").read_text(encoding="utf-8")).substitute(
        title=html.escape(f"Report on {' and '.join(titles)}"),
        contents=" ".join(f'<a href="#part{k}">{html.escape(name)}</a>' for k, (name, _) in enumerate(sections)),
        sections="\n".join(
            f'<section id="part{k}"><h2>{html.escape(name)}</h2>\n{body}</section>'
            for k, (name, body) in enumerate(sections)
        ),
        made_by=f"rail-sumo {assets.own_version()}",
        style=(_PARTS / "style.css").read_text(encoding="utf-8"),
        script="\n".join((_PARTS / name).read_text(encoding="utf-8") for name in ("sort.js", "enlarge.js")),
    )
    with whole_file(out) as partial:
        partial.write_text(page, encoding="utf-8")


def _titles(folders: Sequence[Path]) -> list[str]:
    """Return each folder's name, or its path where another has that name, and its kind: "judged (evaluation)"."""
    names = [folder.resolve().name for folder in folders]
    return [
        f"{name if names.count(name) == 1 else folder} ({_kind(folder)})"
        for name, folder in zip(names, folders, strict=True)
    ]


def _kind(folder: Path) -> str:
    if not folder.is_dir():
        raise InputError(f"'{folder}' is no folder; name one that train, eval, sweep or reproduce has written")
    kind = next((kind for file, kind in KINDS.items() if (folder / file).is_file()), None)
    if kind is None and (folder / report.FINISHED).is_dir():
        raise InputError(
            f"'{folder}' has no tables yet, only what is finished of a sweep or study; its command writes them at the "
            f"end, and goes on if it was stopped"
        )
    if kind is None:
        raise InputError(
            f"'{folder}' is no run, evaluation, sweep or study: it has none of {', '.join(KINDS)}; name a folder that "
            f"train, eval, sweep or reproduce has written"
        )
    return kind


def _about(folder: Path) -> Iterator[str]:
    """Yield the parts of a folder's section, as HTML."""
    yield from _origin(folder)
    if (folder / SUMMARY).is_file() and (folder / EPISODES).is_file():
        episodes = _read(folder / EPISODES)
        yield from _evaluation(episodes, _read(folder / SUMMARY))
        if (folder / DECISIONS).is_file():
            yield from _decisions(_read(folder / DECISIONS), n_networks=episodes["network"].nunique())
    if (folder / PROGRESS).is_file() and (folder / CLONE).is_file() and len(_read(folder / PROGRESS)):
        yield markup.picture(plot.learning_curves([folder]), "How training went, in training traffic.", "Training")
    if (folder / CELLS).is_file():
        yield from _study(folder)
    if (folder / TRAFFIC).is_file():
        yield from _sweep(folder)


def _origin(folder: Path) -> Iterator[str]:
    file = next((folder / name for name in (ORIGIN, assets.MANIFEST) if (folder / name).is_file()), None)
    told = _told_in(file) if file else []
    if (folder / CLONE).is_file() and (unfinished := RunDirectory(folder).unfinished):
        told.append(("note", unfinished))
    if told:
        yield markup.table(pd.DataFrame(told, columns=["", "what was run"]), is_sortable=False)


def _told_in(file: Path) -> list[tuple[str, str]]:
    try:
        about = json.loads(file.read_text(encoding="utf-8"))
        return [
            (key.removesuffix("s") if key in ("modes", "notes") else key, str(line))
            for key in ("command", "seed", "interrupted", "modes", "notes", "rail-sumo", "libsumo")
            if key in about
            for line in _lines(about[key])
        ]
    except (ValueError, TypeError) as error:
        raise InputError(f"'{file}' is damaged: {error}") from None


def _lines(told: Any) -> list[Any]:
    """Return what is told under one key, a list or by name, as one line each."""
    if isinstance(told, dict):
        return [f"{name}: {value}" for name, value in told.items()]
    return told if isinstance(told, list) else [told]


def _evaluation(episodes: pd.DataFrame, summary: pd.DataFrame) -> Iterator[str]:
    policies, reference = list(summary["policy"].unique()), summary["reference"].iloc[0]
    rows = []
    for metric, of_metric in summary.groupby("metric", sort=False):
        by_policy = of_metric.set_index("policy")
        row: dict[str, Any] = {"metric": metric}
        for policy in policies:
            if metric in CONTACTS:
                row[policy] = _with_contact(
                    episodes.loc[episodes["policy"] == policy, str(metric)], by_policy.loc[policy]
                )
                continue
            row[policy] = _with_interval(by_policy.loc[policy], "mean")
            if policy != reference and np.isfinite(by_policy.loc[policy, "ratio"]):
                row[f"{policy}, of {reference}'s"] = _with_interval(by_policy.loc[policy], "ratio")
        rows.append(row)
    most = int(summary["episodes"].max())
    caption = f"Means over {most} episodes, with 95 % intervals; ratios are paired by episode."
    if most == 1:
        caption = "One episode: means have no intervals."
    caption += (
        f" Of {' and '.join(CONTACTS)}: in how many episodes there was one, with the 95 % interval of that share."
    )
    yield "<h3>Evaluation</h3>" + markup.table(pd.DataFrame(rows).astype(object).fillna(""), caption)
    farthest_s = plot_episodes.FARTHEST_TTC_S
    told = (
        "Every episode is a point; the line is the mean, as in the table. Times to collision above "
        f"{farthest_s:g} s are drawn at {farthest_s:g} s, and a policy that has one has no line there."
    )
    yield markup.picture(plot_episodes.points(episodes, policies), told, "Episodes")
    yield markup.details("All episodes", markup.table(episodes))


def _with_contact(contacts: "pd.Series[Any]", row: "pd.Series[Any]") -> markup.Share:
    return markup.Share(int((contacts > 0).sum()), int(row["episodes"]), float(row["low"]), float(row["high"]))


def _with_interval(row: "pd.Series[Any]", what: str) -> markup.Interval:
    ends = ("low", "high") if what == "mean" else (f"{what}_low", f"{what}_high")
    value, low, high = (float(row[name]) for name in (what, *ends))
    return markup.Interval(value, low, high, report.ratio_decimals(low, high, 3) if what == "ratio" else None)


def _decisions(decisions: pd.DataFrame, *, n_networks: int) -> Iterator[str]:
    if decisions.empty:
        return
    shares = {
        f"{policy}, {how}": taken[how].value_counts(normalize=True).reindex(ACTIONS, fill_value=0.0)
        for policy, taken in decisions.groupby("policy", sort=False)
        for how in ("asked", "carried_out")
    }
    table = pd.DataFrame(shares).T.reset_index(names="policy")
    table[ACTIONS] = (100 * table[ACTIONS]).round(1)
    yield "<h3>Decisions</h3>" + markup.table(
        table, "Of 100 decisions, how many asked for each, and how many were carried out."
    )
    if decisions["carried_out"].isin(plot_episodes.SIDES).any():
        told = (
            "Where lane changes were begun, by the distance driven since the host entered, wherever that was: to the "
            "left upwards, to the right downwards. Those that were taken back are among them."
        )
        yield markup.picture(plot_episodes.lane_changes(decisions), told)
        if n_networks == 1 and not plot_episodes.is_straight(decisions):
            told = "The same lane changes on the network's map; grey is the way that was driven."
            yield markup.picture(plot_episodes.lane_change_map(decisions), told)


def _study(folder: Path) -> Iterator[str]:
    if (folder / TABLE1_TOLD).is_file():
        text = (folder / TABLE1_TOLD).read_text(encoding="utf-8").replace("&emsp;", "\u2003").replace("**", "")
        notes = " ".join(line for line in text.splitlines() if line and not line.startswith("|"))
        yield "<h3>Table 1</h3>" + markup.table(_rows_of_markdown(text), notes, is_sortable=False)
    if (folder / TABLE1).is_file():
        yield markup.details("All figures of Table 1", markup.table(_read(folder / TABLE1)))
    yield _figures(folder, "figure_*.svg")
    cells = _read(folder / CELLS)
    by = [name for name in ("system", "trajectories", "seed") if name in cells]
    means = cells.groupby(by, sort=False)[["speed_kmh", "overtakes", "lane_changes", "refused_decisions"]].mean()
    caption = "The mean of each training's held-out episodes."
    yield markup.details("All cells", markup.table(means.round(2).reset_index(), caption))


def _sweep(folder: Path) -> Iterator[str]:
    differences = _read(folder / DIFFERENCES)
    if (folder / SWEEP).is_file():
        yield "<h3>All vehicles</h3>" + markup.table(*_of_markdown((folder / SWEEP).read_text(encoding="utf-8")))
    yield _figures(folder / "figures", "*.svg")
    of_all = differences[differences["vehicles"] == ALL]
    of_all = _with_intervals(of_all.drop(columns="vehicles"), "difference", "relative")
    caption = "Differences from the same runs without driven cars, of all vehicles, with 95 % intervals."
    yield markup.details("All differences", markup.table(of_all, caption))
    means = markup.table(_with_intervals(_read(folder / SUMMARY), "mean"), "Means over seeds, with 95 % intervals.")
    yield markup.details("Means of every arm", means)
    if (folder / EDGES).is_file():
        yield from _edges(_read(folder / EDGES))


def _with_intervals(table: pd.DataFrame, *figures: str) -> pd.DataFrame:
    """Return a table with each of these figures and its interval in one cell, and without the setting if none is."""
    ends = [name for name in table if str(name).endswith(("low", "high"))]
    told = {name: [_with_interval(row, name) for _, row in table.iterrows()] for name in figures}
    told_at = {name: pd.Series(cells, index=table.index, dtype=object) for name, cells in told.items()}
    shown = table.assign(**told_at).drop(columns=ends)
    return shown if (table["setting"] != "").any() else shown.drop(columns="setting")


def _edges(edges: pd.DataFrame) -> Iterator[str]:
    """Yield how a sweep's types of vehicles drove, where most time was lost and where they braked hard."""
    edges = edges.assign(arm=[called(*arm) for arm in edges[ARM].itertuples(index=False)])
    short = {measure: told.heading for measure, told in TOLD.items()}
    short |= {"arm": "driver", "vehkm": "veh km", "drac_above_3_4_per_vehkm": "DRAC > 3.4 m/s², per veh km"}
    short["stops_per_vehkm"] = "stops, per veh km"
    caption = "All vehicles of a type, all seeds together."
    by_type = markup.table(rates(edges, ["arm", "type"]).rename(columns=short), caption)
    yield markup.details("By type", by_type)
    for heading, told, summed, shown in (
        (
            "Where time is lost",
            "Time loss, s a kilometre, on the {} edges where most time is lost",
            "time_loss_s",
            "time_loss_s_per_km",
        ),
        (
            "How fast it is there",
            "Mean speed, km/h, on the {} edges where most time is lost",
            "time_loss_s",
            "speed_kmh",
        ),
        (
            "Where vehicles brake hard",
            "Hard brakings a vehicle kilometre, on the {} edges with most of them",
            "hard_brakings",
            "hard_brakings_per_vehkm",
        ),
    ):
        most = edges.groupby("edge")[summed].sum().nlargest(MOST_EDGES)
        most = most[most > 0]
        if len(most):
            by_edge = rates(edges[edges["edge"].isin(most.index)], ["edge", "arm"])
            beside = by_edge.pivot(index="edge", columns="arm", values=shown)
            beside = beside.loc[most.index, by_edge["arm"].drop_duplicates()].reset_index()
            caption = f"{told.format(len(most))}; all seeds together."
            yield markup.details(heading, markup.table(beside, caption))


def _of_markdown(text: str) -> tuple[pd.DataFrame, str]:
    """Return the table of a Markdown page, and what the page says of it: its heading and first paragraph."""
    heading, _, told, *_ = text.splitlines()
    return _rows_of_markdown(text), f"{heading.removeprefix('# ')}. {told}"


def _rows_of_markdown(text: str) -> pd.DataFrame:
    rows = [
        line.strip().removeprefix("|").removesuffix("|").split("|") for line in text.splitlines() if line[:1] == "|"
    ]
    heads, _, *body = [[cell.strip(" ") for cell in row] for row in rows]
    return pd.DataFrame(body, columns=heads)


def _figures(folder: Path, pattern: str) -> str:
    """Return a folder's figures as a grid of small ones: the measures of the table above, others, what is none."""
    files = {file.stem.removeprefix("figure_"): file for file in sorted(folder.glob(pattern))}
    names = [name for name in dict.fromkeys((*TOLD, *HEADINGS, *files)) if name in files]
    images = (markup.image(files[name].read_bytes(), HEADINGS.get(name, name.replace("_", " "))) for name in names)
    return f'<div class="figures">{"".join(images)}</div>'


def _settings(folders: Sequence[Path]) -> str:
    """Return a table of the keys in which configurations differ from the default, or from one another."""
    found: dict[str, Mapping[str, Any]] = {}
    for folder in folders:
        file = next((folder / name for name in (CONFIG, WORLD) if (folder / name).is_file()), None)
        if file:
            config = config_file.load(file).flat()
            written = flat(tomllib.loads(file.read_text(encoding="utf-8")))
            found[str(folder)] = {key: config[key] for key in written}  # of who drove, nothing about learning
    default = Config().flat()
    keys = [key for key in default if any(config.get(key, default[key]) != default[key] for config in found.values())]
    if not found:
        return ""
    if not keys:
        return "<p>All keys have their defaults.</p>"
    rows = [
        {"key": key, "default": default[key]} | {name: config.get(key, "") for name, config in found.items()}
        for key in keys
    ]
    return markup.table(pd.DataFrame(rows).astype(str), "Keys that differ from the default; all others have theirs.")


def _read(file: Path) -> pd.DataFrame:
    if not file.exists():
        raise InputError(f"'{file}' is not there yet; bring the study to its end by the same command")
    try:
        return pd.read_csv(file) if file.suffix == ".csv" else pd.read_parquet(file)
    except Exception as error:  # whatever pandas and pyarrow stumble over
        raise InputError(f"'{file}' is damaged: {str(error).splitlines()[0]}") from None
