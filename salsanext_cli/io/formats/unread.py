# SPDX-License-Identifier: MIT
"""Files that contain points and are not read, and how to convert each kind."""

import json
import shlex
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

OTHERWISE = "convert it to .ply, for example with CloudCompare"
UNFINISHED = ".bag.active"
PICKLES = (".pkl.gz", ".pkl", ".pickle")
ARCHIVES = (".tar.gz", ".tgz", ".tar", ".zip", ".7z")
PCAPNG = ".pcapng"
GZIP = ".gz"
UNREAD_SUFFIXES = (UNFINISHED, *PICKLES, *ARCHIVES, PCAPNG, GZIP)
"""Suffixes of files with a hint of their own, longer ones first."""


def unread_kind(name: str) -> str:
    """Return the one of the `UNREAD_SUFFIXES` of a file name, in any case; empty for none."""
    return next((kind for kind in UNREAD_SUFFIXES if name.lower().endswith(kind)), "")


def conversion_hint(path: Path) -> str:
    """Return how to convert a file that is not read to one that is."""
    kind = unread_kind(path.name)
    if kind == UNFINISHED:
        finished = path.name[: -len(".active")]
        file = shlex.quote(str(path))
        return f"run `rosbag reindex {file}`, then rename it to {finished}"
    if kind in PICKLES:
        return _pickle_hint(path, kind)
    if kind in ARCHIVES:
        return "unpack it, and give the folder"
    if kind == PCAPNG:
        return pcapng_hint(path)
    return "decompress it with gunzip" if kind == GZIP else OTHERWISE


def pcapng_hint(path: Path) -> str:
    """Return the command that converts a capture in the format pcapng, whatever its suffix."""
    target = path.with_suffix(".pcap")
    if target == path:
        target = path.with_name(f"{path.stem}-converted.pcap")
    return f"convert it: `editcap -F pcap {shlex.quote(str(path))} {shlex.quote(str(target))}`"


def folder_hint(folder: Path, names: Sequence[str]) -> str:
    """Return the hint for the most frequent kind of unread files in a folder; empty for none."""
    counts = Counter(kind for kind in map(unread_kind, names) if kind)
    if not counts:
        return ""
    most = max(sorted(counts), key=counts.__getitem__)
    first = min(name for name in names if unread_kind(name) == most)
    return f"{first}: {conversion_hint(folder / first)}"


def _pickle_hint(path: Path, kind: str) -> str:
    """Return the command that converts all pickled tables of a folder."""
    files = f'pathlib.Path({json.dumps(str(path.parent))}).glob("*{kind}")'
    target = f'str(p).removesuffix("{kind}") + ".csv"'
    code = f"[pandas.read_pickle(p).to_csv({target}, index=False) for p in {files}]"
    command = f"python -c {shlex.quote(f'import pandas, pathlib; {code}')}"
    return f"a pickle may run code; if you trust it: {command}"
