"""What is installed, and what is to be done where it does not fit: a missing extra, an older install of the same."""

from collections.abc import Sequence
from pathlib import Path

DISTRIBUTION = "asterism-localization"
OLDER = "asterism"  # what the distribution was called before; on the package index that is somebody else's

# Modules by the distributions that bring them, and what to install for these: the base or an extra. A test compares
# them with pyproject.toml.
MODULES = {
    "cv2": ("opencv-python-headless", "server"),
    "matplotlib": ("matplotlib", "server"),
    "mcap": ("mcap", "server"),
    "numba": ("numba", "server"),
    "scipy": ("scipy", "server"),
    "prometheus_client": ("prometheus-client", "metrics"),
    "pyarrow": ("pyarrow", "parquet"),
    "rosbags": ("rosbags", "ros"),
    "cyclonedds": ("cyclonedds", "dds"),
    "dask": ("dask", "cluster"),
    "distributed": ("distributed", "cluster"),
    "rerun": ("rerun-sdk", "review"),
    "foxglove": ("foxglove-sdk", "foxglove"),
    "foxglove_schemas_protobuf": ("foxglove-schemas-protobuf", ""),
    "google": ("protobuf", ""),
    "msgspec": ("msgspec", ""),
    "numpy": ("numpy", ""),
    "rich": ("rich", ""),
    "ruamel": ("ruamel.yaml", ""),
    "zenoh": ("eclipse-zenoh", ""),
}


def missing_module(name: str, words: Sequence[str]) -> str:
    """What to say where a module is missing that we need; nothing where we don't, which is an error of ours."""
    top = name.partition(".")[0]
    if top not in MODULES:
        return ""
    extra = MODULES[top][1]
    what = f"'{DISTRIBUTION}[{extra}]'" if extra else DISTRIBUTION
    command = f"asterism {words[0]}" if words else "asterism"
    return f"{command} needs the module {name}, which is not installed; install it with: pip install {what}"


def older_install(path: Sequence[str]) -> str:
    """What to do where this program is also installed under its older name, on the module path ``path``; or nothing.

    Both installs hold the same files, so that uninstalling one takes files of the other away.
    """
    folders = [Path(entry) for entry in path if _holds_older(entry)]
    if not folders:
        return ""
    from importlib.metadata import distributions

    for found in distributions(name=OLDER, path=[str(folder) for folder in folders]):
        if _is_ours(found.read_text("RECORD") or "", found.read_text("entry_points.txt") or ""):
            return (
                f"warning: version {found.version} of this program is installed beside this one under its older name, "
                f"'{OLDER}'; they share files, so remove both and install again: pip uninstall {OLDER} {DISTRIBUTION}"
                f", then: pip install '{DISTRIBUTION}[server]', or whatever you installed it from"
            )
    return ""


def _holds_older(folder: str) -> bool:
    """Whether metadata of that name lie there; importlib.metadata alone takes 50 ms to be imported."""
    try:
        names = [entry.name for entry in Path(folder).iterdir()]
    except OSError:
        return False
    return any(name.startswith(f"{OLDER}-") and name.endswith((".dist-info", ".egg-info")) for name in names)


def _is_ours(record: str, entry_points: str) -> bool:
    """An editable install's record names none of our files, but its command is ours."""
    return (
        any(line.startswith("asterism/server/") for line in record.splitlines()) or "asterism.server." in entry_points
    )
