"""A name -> a verified file: shipped networks, demand and the expert, from a wheel or a checkout."""

import hashlib
import json
import tomllib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rail_sumo.errors import InputError, did_you_mean

NETWORK_SUFFIX = ".net.xml"
ROUTES_SUFFIX = ".rou.xml"
MANIFEST = "manifest.json"
"""Names an expert's files with their SHA-256, and tells how it was made."""
EXPERT_POLICY = "policy.safetensors"
EXPERT_RECIPE = "config.toml"
EXPERT_DEMONSTRATIONS = "demonstrations.parquet"

DRIVERS = "drivers"
SHIPPED_EXPERTS = ("road-expert",)
"""Experts among the shipped drivers."""
DRIVES_BY = (EXPERT_POLICY, EXPERT_RECIPE, "clone.safetensors")
"""The files that a shipped driver is read from."""

_PACKAGE = Path(__file__).parent


def network(name_or_path: str) -> Path:
    """Return the file of a shipped network, or the user's own file if it can be read.

    Raises:
        InputError: an unknown name (with a suggestion), no such file, or one that cannot be read.
    """
    return _find("network", name_or_path, NETWORK_SUFFIX, "networks")


def absolute(name_or_path: str) -> str:
    """Return the absolute path of a file that is there; what goes by a name of ours stays as it is."""
    path = Path(name_or_path)
    is_a_name = name_or_path in (*network_names(), *routes_names(), *SHIPPED_EXPERTS, "shipped")
    return name_or_path if is_a_name or not path.exists() else str(path.absolute())


def network_name(name_or_path: str) -> str:
    """Return what tables call a network: its file's name without the suffix."""
    return Path(name_or_path).name.removesuffix(".gz").removesuffix(NETWORK_SUFFIX)


def routes(name_or_path: str) -> Path:
    """Return the file of a shipped demand example, or the user's own; errors as in `network`."""
    return _find("routes", name_or_path, ROUTES_SUFFIX, "routes")


def additional(path: str) -> Path:
    """Return one of SUMO's additional files, always the user's own; errors as in `network`."""
    return _own("additional", Path(path))


def network_names() -> tuple[str, ...]:
    """Return the shipped networks' names in alphabetical order."""
    return _names("networks", NETWORK_SUFFIX)


def routes_names() -> tuple[str, ...]:
    """Return the names of the shipped demand; each is that of the network it is for."""
    return _names("routes", ROUTES_SUFFIX)


def expert_folder(name_or_path: str) -> Path:
    """Return the folder of an expert: "shipped", the name of a shipped driver, or the user's own folder."""
    if name_or_path == "shipped":
        return data_root() / "expert"
    shipped = data_root() / DRIVERS / name_or_path
    return shipped if name_or_path in SHIPPED_EXPERTS else Path(name_or_path)


def expert(filename: str, folder: Path | None = None) -> Path:
    """Return a file of an expert, the shipped one unless told, after comparing its SHA-256 with `manifest.json`.

    Raises:
        InputError: not in the manifest, missing, or changed since the manifest was written.
    """
    folder = folder or expert_folder("shipped")
    files = _manifest(folder / MANIFEST)
    if filename not in files:
        raise InputError(f"expert file '{filename}' not found{did_you_mean(filename, files)}")
    path = _readable("expert", folder / filename)
    found = sha256(path)
    if found != files[filename]:
        raise InputError(
            f"expert file '{path}' is damaged or was changed: its SHA-256 is {found[:12]}..., the manifest says "
            f"{files[filename][:12]}...; reinstall rail-sumo or train the expert anew (rail-sumo expert train)"
        )
    return path


def is_expert(folder: Path) -> bool:
    """Return whether a folder is an expert's: whether its manifest tells of demonstrations.

    Raises:
        InputError: the manifest cannot be read.
    """
    return (folder / MANIFEST).is_file() and EXPERT_DEMONSTRATIONS in _manifest(folder / MANIFEST)


def require_expert(folder: Path) -> None:
    """Raise InputError if a folder is a run's, or another that has a manifest and is no expert's."""
    if (folder / MANIFEST).is_file() and not is_expert(folder):
        raise InputError(
            f"'{folder}' is a run, or another folder with a {MANIFEST}, and not an expert's; name shipped, "
            f"{', '.join(SHIPPED_EXPERTS)} or a folder that rail-sumo expert train has written"
        )


def driver(name: str) -> Path:
    """Return the folder of a shipped driver, after comparing what is needed to drive with its `manifest.json`.

    Raises:
        InputError: as in `expert`.
    """
    folder = data_root() / DRIVERS / name
    for filename in _manifest(folder / MANIFEST):
        if filename in DRIVES_BY:
            expert(filename, folder)
    return folder


def sha256(path: Path) -> str:
    """Return a file's SHA-256 in hexadecimal, as the manifest keeps it."""
    with path.open("rb") as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def own_version() -> str:
    """Return the version of rail-sumo that is at work."""
    try:
        return version("rail-sumo")
    except PackageNotFoundError:
        return "not installed"  # run from a checkout


@cache
def data_root() -> Path:
    """Return the folder that holds `networks/`, `routes/` and `expert/`: inside a wheel, or the checkout.

    Raises:
        InputError: neither is there; the installation is incomplete.
    """
    shipped = _PACKAGE / "_data"
    if shipped.is_dir():
        return shipped
    checkout = _PACKAGE.parent
    if _is_ours(checkout / "pyproject.toml"):
        return checkout
    raise InputError(f"rail-sumo's networks and expert are missing beside '{_PACKAGE}'; reinstall rail-sumo")


def _is_ours(pyproject: Path) -> bool:
    try:
        project = tomllib.loads(pyproject.read_text(encoding="utf-8")).get("project", {})
    except (OSError, tomllib.TOMLDecodeError, UnicodeDecodeError):
        return False
    return project.get("name") == "rail-sumo"


def _find(kind: str, name_or_path: str, suffix: str, folder: str) -> Path:
    names = _names(folder, suffix)
    if name_or_path in names:
        return _readable(kind, data_root() / folder / f"{name_or_path}{suffix}")
    path = Path(name_or_path)
    looks_like_a_path = "/" in name_or_path or "\\" in name_or_path or bool(path.suffix)
    if looks_like_a_path or path.is_file():
        return _own(kind, path)
    raise InputError(f"{kind} '{name_or_path}' not found{did_you_mean(name_or_path, names)}")


def _names(folder: str, suffix: str) -> tuple[str, ...]:
    files = (data_root() / folder).glob(f"*{suffix}")
    return tuple(sorted(path.name.removesuffix(suffix) for path in files))


def _own(kind: str, path: Path) -> Path:
    if "," in str(path):
        raise InputError(f"{kind} file '{path}' has a comma in its path, where SUMO would split it in two; rename it")
    return _readable(kind, path)


def _readable(kind: str, path: Path) -> Path:
    try:
        with path.open("rb"):
            return path
    except FileNotFoundError:
        raise InputError(f"{kind} file '{path}' does not exist (current folder: {Path.cwd()})") from None
    except OSError as error:
        raise InputError(f"{kind} file '{path}' cannot be read: {error.strerror}") from None


def _manifest(path: Path) -> dict[str, str]:
    try:
        files = json.loads(path.read_text(encoding="utf-8"))["files"]
    except FileNotFoundError:
        raise InputError(
            f"no expert here: '{path}' is missing; train one (rail-sumo expert train); any other driver is imitated "
            "from what it did (rail-sumo expert record --driver)"
        ) from None
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(f"the expert's manifest '{path}' cannot be read: {error!r}; reinstall rail-sumo") from None
    if not isinstance(files, dict):
        raise InputError(f"the expert's manifest '{path}' must map file names to SHA-256 under 'files'")
    return files
