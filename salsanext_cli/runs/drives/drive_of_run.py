# SPDX-License-Identifier: MIT
"""Drive by which a fusion fuses a sequence, and its record beside the fused labels."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.optional_packages import import_extra
from salsanext_cli.core.poses import POSES
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.files.json_files import encode_json, read_json
from salsanext_cli.io.poses import encode_poses
from salsanext_cli.runs.drives.drive_record import DRIVE, drive_record, recorded_drive
from salsanext_cli.runs.drives.earlier_fusion import earlier_fusion, other_drive
from salsanext_cli.runs.drives.scans_of_drive import computed_drive
from salsanext_cli.runs.results.output_paths import find_outputs
from salsanext_cli.runs.results.output_run import OutputRun
from salsanext_cli.runs.results.owned_folder import foreign_file
from salsanext_cli.runs.results.recorded_origins import recorded_origins
from salsanext_cli.runs.scans.scan_file import ScanFile


def drive_of_run(
    files: Sequence[ScanFile],
    drive_by_poses: Drive | SalsanextError | None,
    single: OutputRun,
    fused: OutputRun,
    sensor: Sensor,
) -> Drive:
    """Return the drive of a sequence and record it; results by another drive are removed.

    Parameters
    ----------
    files : sequence of ScanFile
        Scans of the sequence in the order of the drive.
    drive_by_poses : Drive, SalsanextError or None
        Drive by poses or registration, or the error of it. With None, the drive is that of the
        record, else it is computed.
    single : OutputRun
        Run that writes beside the labels of single scans.
    fused : OutputRun
        Run that writes the fused labels.
    sensor : Sensor
        Sensor that was fitted to the scans.

    Returns
    -------
    Drive

    Raises
    ------
    SalsanextError
        If there are results by another drive that the run does not overwrite.
    """
    if isinstance(drive_by_poses, SalsanextError):
        raise drive_by_poses
    folder = _folder_of_drive(files, fused)
    earlier = _earlier_drive(folder, files, single, fused)
    drive = drive_by_poses or earlier
    if drive is None:
        drive = computed_drive(files, sensor, recorded_origins(single.root, sensor))
    _record_drive(drive, folder, files, single, fused)
    return drive


def foresee_drive(
    files: Sequence[ScanFile],
    drive_by_poses: Drive | SalsanextError | None,
    single: OutputRun,
    fused: OutputRun,
) -> bool:
    """Refuse what `drive_of_run` refuses; return whether earlier results stay.

    Nothing is written, and poses that are not recorded are not computed. Arguments as of
    `drive_of_run`.
    """
    if isinstance(drive_by_poses, SalsanextError):
        raise drive_by_poses
    folder = _folder_of_drive(files, fused)
    drive = drive_by_poses or _earlier_drive(folder, files, single, fused)
    recorded = read_json(folder / DRIVE)
    if drive is None and recorded is not None and not fused.overwrite:
        return True  # Only the poses are gone, which are computed again
    if drive is None:
        import_extra("small_gicp", "fuse")
    elif recorded == drive_record(drive, _stems(files)):
        return not fused.overwrite
    _require_replaceable(folder, recorded, files[0].sequence, single, fused)
    return False


def _folder_of_drive(files: Sequence[ScanFile], fused: OutputRun) -> Path:
    """Return the folder of the record of a drive; refuse poses there that somebody changed."""
    folder = fused.root / "sequences" / files[0].sequence
    if fused.foreign_files([folder / POSES]):
        raise foreign_file(folder / POSES)
    return folder


def _earlier_drive(
    folder: Path, files: Sequence[ScanFile], single: OutputRun, fused: OutputRun
) -> Drive | None:
    """Return the recorded drive of the same scans; None without any, and if it is overwritten."""
    if fused.overwrite:
        return None
    record = read_json(folder / DRIVE)
    if record is None:
        return None
    if record.get("scans") != _stems(files):
        raise other_drive(folder / DRIVE, single)
    return recorded_drive(folder)


def _record_drive(
    drive: Drive, folder: Path, files: Sequence[ScanFile], single: OutputRun, fused: OutputRun
) -> None:
    """Write the record of a drive, after removing results by another drive."""
    content = drive_record(drive, _stems(files))
    with fused.locked_records():
        recorded = read_json(folder / DRIVE)
        if recorded == content:
            return
        name = files[0].sequence
        _require_replaceable(folder, recorded, name, single, fused)
        single.remove_written(_results_of(single, name))
        fused.remove_written(_results_of(fused, name))
        fused.write(folder / POSES, encode_poses(drive.poses))
        # Last: without the record, a run that was killed before begins again.
        fused.write(folder / DRIVE, encode_json(content))


def _require_replaceable(
    folder: Path,
    recorded: Mapping[str, Any] | None,
    sequence: str,
    single: OutputRun,
    fused: OutputRun,
) -> None:
    """Refuse to replace results of a sequence by another drive than the recorded one, if any."""
    results_of_fused = _results_of(fused, sequence)
    if fused.overwrite or not (results_of_fused or _results_of(single, sequence)):
        return
    if recorded is None and not results_of_fused:
        raise earlier_fusion(single, fused.root, sequence)
    raise other_drive(folder / DRIVE, single)


def _stems(files: Sequence[ScanFile]) -> list[str]:
    return [file.stem for file in files]


def _results_of(run: OutputRun, sequence: str) -> list[Path]:
    """Return the files of the results of a sequence in the folders of a run."""
    paths: list[Path] = []
    for folder in run.folders:
        for (name, _), path in find_outputs(run.root, folder).items():
            if name == sequence:
                paths.append(path)
    return paths
