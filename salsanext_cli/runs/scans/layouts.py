# SPDX-License-Identifier: MIT
"""Layouts of public data sets: names of the sequences and places of the labels."""

from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.io.files.reading import present

SCAN_FOLDER = "velodyne"
PICK_RECORD = "pick.json"  # Record of `pick`
TOOL_FOLDER = "tools"  # In a data set of picked scans: a folder for each labelling tool
LABEL_FOLDER = "labels"
SEQUENCE = "{sequence}"
ANY = "*"


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Layout of the folders of scans of a data set.

    Attributes
    ----------
    name : str
        Name of the data set.
    folder_names : tuple of str
        Last names in the path of a folder of scans; `ANY` stands for any name, and `SEQUENCE` for
        that of the sequence. Without `SEQUENCE`, the folder of scans names it.
    has_labels : bool
        Whether labels lie in the same folders below ``labels`` instead of the first part.
    scan_ending, label_ending : str
        Ends of the stems of a scan and of its labels.
    after_drive : str
        What follows the name of the drive in the stem of a scan, if a folder has several drives.
    scan_suffix : str
        Suffix of the scans, if folders of other origin have the same names.
    files_beside : tuple of str
        Files of which one lies beside the scans, if folders of other origin have the same names.
    is_general : bool
        Whether drives in several places may have one name, since it is no name of a data set.
    """

    name: str
    folder_names: tuple[str, ...]
    has_labels: bool = False
    scan_ending: str = ""
    label_ending: str = ""
    after_drive: str = ""
    scan_suffix: str = ""
    files_beside: tuple[str, ...] = ()
    is_general: bool = False

    def fits(self, folder: Path, names: Collection[str]) -> bool:
        """Return whether a folder of scans with these names is one of this layout."""
        if len(folder.parts) <= len(self.folder_names):
            return False
        for pattern, name in zip(self.folder_names, self._folders(folder), strict=True):
            if pattern not in (ANY, SEQUENCE, name):
                return False
        has_ending = any(name.partition(".")[0].endswith(self.scan_ending) for name in names)
        has_suffix = any(name.endswith(self.scan_suffix) for name in names)
        if not (has_ending and has_suffix):
            return False
        return not self.files_beside or any(present(folder / name) for name in self.files_beside)

    def _folders(self, folder: Path) -> tuple[str, ...]:
        """Return the last names in the path of a folder, one for each of `folder_names`."""
        return folder.parts[-len(self.folder_names) :]

    def sequence(self, folder: Path) -> str:
        """Return the name of the sequence of a folder of scans."""
        by_pattern = dict(zip(self.folder_names, self._folders(folder), strict=True))
        return by_pattern.get(SEQUENCE, folder.name)

    def sequence_below(self, folder: Path, root: Path) -> str:
        """Return the name of the sequence of a folder of scans below a root.

        It depends on the path alone, so that other drives below the root do not change it.
        """
        if not self.is_general:
            return self.sequence(folder)
        relative = folder.relative_to(root).parts
        above = (ANY,) * len(relative)
        pairs = zip((*above, *self.folder_names)[-len(relative) :], relative, strict=True)
        names = [name for pattern, name in pairs if pattern in (ANY, SEQUENCE)]
        return "_".join(names) or self.sequence(folder)

    def drive(self, stem: str) -> str:
        """Return the name of the drive in the stem of a scan; empty without one."""
        is_named = self.after_drive and self.after_drive in stem
        return stem.partition(self.after_drive)[0] if is_named else ""

    def root(self, folder: Path) -> Path:
        """Return the root of the data set with a folder of scans."""
        return folder.parents[len(self.folder_names) - 1]

    def label_path(self, folder: Path, stem: str) -> Path | None:
        """Return the path of the labels of a scan, which may not exist; None without labels."""
        if not self.has_labels:
            return None
        inside = Path(LABEL_FOLDER, *folder.parts[1 - len(self.folder_names) :])
        if self.scan_ending and stem.endswith(self.scan_ending):
            stem = stem.removesuffix(self.scan_ending) + self.label_ending
        return self.root(folder) / inside / f"{stem}.label"


LAYOUTS = (
    Layout(name="SemanticKITTI", folder_names=("sequences", SEQUENCE, SCAN_FOLDER)),
    Layout(name="SemanticKITTI", folder_names=(SEQUENCE, SCAN_FOLDER), is_general=True),
    Layout(
        name="SemanticKITTI", folder_names=(SCAN_FOLDER, SEQUENCE), has_labels=True, is_general=True
    ),
    Layout(name="KITTI raw data", folder_names=(SEQUENCE, "velodyne_points", "data")),
    Layout(name="nuScenes", folder_names=("samples", "LIDAR_TOP"), after_drive="__LIDAR_TOP__"),
    Layout(name="Argoverse 2", folder_names=(SEQUENCE, "sensors", "lidar"), scan_suffix=".feather"),
    Layout(
        name="GOOSE",
        folder_names=("lidar", ANY, SEQUENCE),
        has_labels=True,
        scan_ending="_vls128",
        label_ending="_goose",
    ),
    Layout(
        name="PandaSet",
        folder_names=(SEQUENCE, "lidar"),
        files_beside=("poses.json", "timestamps.json"),
    ),
)
"""Known layouts; the first one that fits a folder counts."""


def layout_of(folder: Path, names: Collection[str]) -> Layout | None:
    """Return the layout of a folder of scans with these names; None for any other folder."""
    return next((layout for layout in LAYOUTS if layout.fits(folder, names)), None)


def sequence_name(folder: Path, names: Collection[str]) -> str:
    """Return the name of the sequence of a folder of scans; the root of a disk has no name."""
    layout = layout_of(folder, names)
    name = layout.sequence(folder) if layout else folder.name
    return name or folder.name or "scans"
