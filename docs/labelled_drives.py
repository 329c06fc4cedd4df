# SPDX-License-Identifier: MIT
"""Labelled real drives that the figures of the guides are measured on."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

STUDIES = Path(__file__).parents[1] / "benchmarks/studies"
FIVE_CLASSES = ("--classes", STUDIES / "five.yaml")
FIVE_CLASSES_OF_NUSCENES = ("--label-space", STUDIES / "nuscenes-five.yaml")
SINGLE_SCANS = "x2"
"""Sequence of SemanticKITTI whose scans are each of another drive."""


@dataclass(frozen=True, kw_only=True)
class LabelledDrive:
    """A drive with ground truth, and the options that `predict` and `eval` need for it."""

    name: str
    dataset: Path
    """Root of the data set."""
    sequence: str
    classes: tuple[object, ...] = ()
    """Options of `predict`."""
    labels: tuple[object, ...] = ()
    """Options of `eval`."""


def linked_semantickitti(data: Path, root: Path) -> list[str]:
    """Make a data set of links to all labelled scans of SemanticKITTI, one sequence per drive.

    Parameters
    ----------
    data : Path
        Folder with ``semantickitti`` and ``semantickitti_drives``. Both have a sequence 08, of
        different parts of that drive.
    root : Path
        Folder of the new data set.

    Returns
    -------
    list of str
        Names of the sequences.
    """
    names = []
    for source in ("semantickitti", "semantickitti_drives"):
        for folder in sorted((data / source / "sequences").iterdir()):
            for scan in sorted((folder / "velodyne").iterdir()):
                name = folder.name
                if name == SINGLE_SCANS:
                    name = f"{name}-{scan.stem}"
                elif source == "semantickitti_drives" and name == "08":
                    name = "08-later"
                link_scan(scan, root / "sequences" / name)
                names.append(name)
    return list(dict.fromkeys(names))


def link_scan(scan: Path, sequence: Path) -> None:
    """Make links to a scan and to its labels in a sequence."""
    label = scan.parents[1] / "labels" / f"{scan.stem}.label"
    for source in (scan, label):
        place = sequence / source.parent.name / source.name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.symlink_to(source.resolve())


def judged_drives(data: Path, root: Path) -> list[LabelledDrive]:
    """Return the real drives on which the estimated accuracy is judged, each predicted alone.

    Parameters
    ----------
    data : Path
        Folder of the real scans.
    root : Path
        New folder for data sets of links.

    Returns
    -------
    list of LabelledDrive
        Ten excerpts of SemanticKITTI, two of them of one drive, one drive of PandaSet by both
        sensors, and two of nuScenes. Training saw none of the scans, but earlier ones of PandaSet.
    """
    kitti = root / "semantickitti"
    drives = [
        LabelledDrive(name=f"SemanticKITTI {sequence}", dataset=kitti, sequence=sequence)
        for sequence in linked_semantickitti(data, kitti)
    ]
    for name, count in {"pandaset": 10, "pandargt": 3}.items():
        scans = sorted((data / name / "sequences/002/velodyne").iterdir())
        for scan in scans[-count:]:
            link_scan(scan, root / name / "sequences/002")
        drives.append(LabelledDrive(name=f"{name} 002", dataset=root / name, sequence="002"))
    for sequence in ("0001", "0004"):
        drives.append(
            LabelledDrive(
                name=f"nuScenes {sequence}",
                dataset=data / "drives",
                sequence=sequence,
                classes=FIVE_CLASSES,
                labels=FIVE_CLASSES_OF_NUSCENES,
            )
        )
    return drives
