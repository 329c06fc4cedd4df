# SPDX-License-Identifier: MIT
"""Stage `export-rrd`: scans and results to recordings for the Rerun viewer."""

import logging
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from itertools import groupby
from pathlib import Path

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import NOTICE, OutputError, printable
from salsanext_cli.files.atomic import sweep_stale
from salsanext_cli.parallel.run import Outcome, RunOptions, run_over_scans
from salsanext_cli.records import Float
from salsanext_cli.report.colours import PointColours, common_scales
from salsanext_cli.report.rerun_recording import Columns, LogScan, import_rerun, recording
from salsanext_cli.results.owned_folder import OwnedFolder
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.results.query import ResultQuery
from salsanext_cli.results.result_folder import ResultFolder, scalar_columns
from salsanext_cli.results.uncertainty_kinds import UNCERTAINTY
from salsanext_cli.sensors.sensor import Sensor

FOLDER = "rrd"
VIEWS = ("label", "truth", "wrong", *UNCERTAINTY)

log = logging.getLogger(__name__)


def export_rrd(
    out: Path, *, query: ResultQuery = ResultQuery(), options: RunOptions = RunOptions()
) -> Outcome:
    """Write `OUT/rrd/<seq>.rrd`: points, classes, uncertainties and every other known scalar."""
    results = ResultFolder(out, query.dataset)
    import_rerun()
    try:
        str(out).encode()
    except UnicodeEncodeError as error:
        found = "its name is no UTF-8, which rerun-sdk cannot open"
        raise OutputError(out, found, hint="rename it") from error
    chosen = results.chosen(query)
    scans, space, sensor = chosen.scans, chosen.space, results.sensor()
    OwnedFolder(out).refuse_foreign(_path(out, scan.sequence) for scan in scans)
    sweep_stale(out / FOLDER)
    known = [name for name in VIEWS if results.with_column(name, scans)]
    scales = common_scales(out, scans, known, space, sensor)
    colouring = partial(PointColours, space=space, dark=True)
    colourings = {name: colouring(name, scales.get(name, (0, 1))) for name in known}
    sequences = groupby(results.scans(), lambda scan: scan.sequence)
    numbers = {file: number for _, files in sequences for number, file in enumerate(files)}
    log_scan: dict[str, LogScan] = {}
    with ExitStack() as held:

        def keep(found: tuple[ScanFile, Float, Columns]) -> None:
            file, points, columns = found
            if file.sequence not in log_scan:
                held.close()  # Scans are sorted: the recording before is complete.
                opened = _recording(out, file.sequence, colourings, space)
                log_scan[file.sequence] = held.enter_context(opened)
            text = _text(file, columns, colourings)
            log_scan[file.sequence](numbers[file], text, points, columns)

        task = partial(_read, out=out, sensor=sensor, classes=query.classes)
        task = partial(task, space=space, labels=chosen.labels)
        in_turn = RunOptions(on_error=options.on_error, progress=options.progress)
        outcome = run_over_scans(task, scans, in_turn, on_result=keep)
    return replace(outcome, missing=chosen.missing)


def _path(out: Path, sequence: str) -> Path:
    return out / FOLDER / f"{sequence}.rrd"


@contextmanager
def _recording(
    out: Path, sequence: str, colourings: Mapping[str, PointColours], space: LabelSpace
) -> Iterator[LogScan]:
    """Write the recording of a sequence, which appears under its name when it is complete."""
    path, owned = _path(out, sequence), OwnedFolder(out)
    name = printable(f"{out.absolute().name}/{sequence}")
    with owned.writing(path, durable=True) as file:
        with recording(file, name, colourings, space) as log_scan:
            yield log_scan
        owned.refuse_foreign([path])
    log.log(NOTICE, "recording: %s", path)


def _read(
    file: ScanFile,
    out: Path,
    sensor: Sensor,
    classes: LabelSpace | None,
    space: LabelSpace,
    labels: LabelSpace,
) -> tuple[ScanFile, Float, Columns]:
    """Read the points of a scan and every known scalar."""
    results = ResultFolder(out).read(file, sensor, classes, (labels, space))
    return file, results.scan.points, scalar_columns(results, space)


def _text(file: ScanFile, columns: Columns, colourings: Mapping[str, PointColours]) -> str:
    """Return the name of a scan and the meaning of its colours, as Markdown."""
    shown = (
        (each.legend if name in columns else f"no {name}") for name, each in colourings.items()
    )
    return "\n".join([printable(f"# {file.name}"), "", *(f"- {text}" for text in shown)])
