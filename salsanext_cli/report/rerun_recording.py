# SPDX-License-Identifier: MIT
"""Recordings for the Rerun viewer, through rerun-sdk, which is imported when it is used."""

import errno
import os
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any, BinaryIO

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import UsageError
from salsanext_cli.files.optional_packages import import_extra
from salsanext_cli.records import Float
from salsanext_cli.report.colours import EMPTY, PointColours, screen_colours

TIMELINE, POINTS, TEXT = "scan", "points", "text"
SCANS_PER_SECOND = 10.0
NOT_WHOLE = errno.EIO, "rerun-sdk did not write all of it: the disk may be full"
"""Reason why a file is not whole, of which rerun-sdk tells only its log."""

Columns = Mapping[str, npt.NDArray[Any]]
LogScan = Callable[[int, str, Float, Columns], None]
"""Logs a scan: number on the timeline, text in Markdown, points (N, 3) and scalar columns."""


def import_rerun() -> Any:
    """Import rerun-sdk, with a module that older versions lack."""
    rerun = import_extra("rerun", "rerun")
    import_extra("rerun.chunk", "rerun")
    return rerun


@contextmanager
def recording(
    file: BinaryIO, name: str, colourings: Mapping[str, PointColours], space: LabelSpace
) -> Iterator[LogScan]:
    """Write a recording of a name to a new, open file while the body logs scans, by colouring."""
    rerun = import_rerun()
    stream = rerun.RecordingStream("salsanext", send_properties=False)
    if not rerun.is_enabled(stream):
        raise UsageError("RERUN", os.environ["RERUN"], "on, in the environment")
    numbers: list[int] = []

    def log_scan(number: int, text: str, points: Float, columns: Columns) -> None:
        index = [rerun.TimeColumn(TIMELINE, sequence=[number])]
        document = rerun.TextDocument.columns(text=[text], media_type=["text/markdown"])
        stream.send_columns(POINTS, index, _components(rerun, points, columns, colourings))
        stream.send_columns(TEXT, index, document)
        numbers.append(number)

    strict = rerun.strict_mode()
    rerun.set_strict_mode(True)  # Otherwise it leaves out what it cannot log.
    try:
        try:
            stream.save(file.name, _layout(rerun, colourings))
        except RuntimeError as error:
            raise OSError(*NOT_WHOLE) from error
        stream.send_recording_name(name)
        stream.log(POINTS, _classes(rerun, space), static=True)
        yield log_scan
        # A viewer shows each scan until the next: the first of those missing between ends it.
        gaps = sorted({number + 1 for number in numbers} - {*numbers})[:-1]
        if gaps:
            ends = rerun.Clear.columns(is_recursive=[True] * len(gaps))
            stream.send_columns("/", [rerun.TimeColumn(TIMELINE, sequence=gaps)], ends)
    finally:
        rerun.set_strict_mode(strict)
        stream.disconnect()
    if _chunk_count(rerun, file) != 2 + 2 * len(numbers) + bool(gaps):
        raise OSError(*NOT_WHOLE)


def _components(
    rerun: Any, points: Float, columns: Columns, colourings: Mapping[str, PointColours]
) -> Iterator[Any]:
    """Yield all components of a scan; an empty one ends that of the scan before."""
    types, slots = rerun.components, rerun.Points3D

    def column(descriptor: Any, batch: Any) -> Any:
        return rerun.ComponentColumn(descriptor, batch, lengths=[len(batch.as_arrow_array())])

    def named(name: str, slot: Any) -> Any:
        """Return the name of a component of the type that Points3D has in a slot."""
        part = slot.component.partition(":")[2]
        return rerun.ComponentDescriptor(f"{name}:{part}", name, slot.component_type)

    yield column(slots.descriptor_positions(), types.Position3DBatch(points))
    for name in dict.fromkeys([*columns, *colourings]):
        values = columns.get(name, np.empty(0, np.float32))
        if name == "label":
            yield column(slots.descriptor_class_ids(), types.ClassIdBatch(values))
        elif name == "truth":
            yield column(named(name, slots.descriptor_class_ids()), types.ClassIdBatch(values))
        else:
            value = rerun.ComponentDescriptor(f"{name}:value", name)
            yield column(value, rerun.AnyBatchValue(value, values, drop_untyped_nones=False))
        if name in colourings:
            rgb = colourings[name].of_points(columns) if name in columns else [EMPTY]
            yield column(named(name, slots.descriptor_colors()), types.ColorBatch(rgb))


def _classes(rerun: Any, space: LabelSpace) -> Any:
    """Return name and colour of every raw id."""
    colours = screen_colours(space).tolist()
    classes = [
        (raw, space.labels.get(raw, space.names[train]), tuple(colours[train]))
        for raw, train in space.learning_map.items()
    ]
    return rerun.AnnotationContext(classes)


def _layout(rerun: Any, colourings: Iterable[str]) -> Any:
    """Return a view of the points for each colouring, and one of the text."""
    blueprint, encodings = rerun.blueprint, rerun.blueprint.encodings
    slot = rerun.Points3D.descriptor_colors().component
    source = encodings.ComponentSourceKind.SourceComponent
    views = []
    for name in colourings:
        component = f"{name}:colors"
        colours = encodings.VisualizerComponentMapping(slot, source, source_component=component)
        shown = rerun.Points3D.from_fields().visualizer(mappings=[colours])
        views.append(blueprint.Spatial3DView(origin=POINTS, name=name, overrides={POINTS: shown}))
    text = blueprint.TextDocumentView(origin=TEXT, name=TEXT)
    time = blueprint.TimePanel(timeline=TIMELINE, fps=SCANS_PER_SECOND, state="collapsed")
    return blueprint.Blueprint(blueprint.Grid(*views, text), time)


def _chunk_count(rerun: Any, file: BinaryIO) -> int:
    """Return the number of chunks that the index of a recording lists, 0 without an index."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # That there is none.
            return len(rerun.chunk.RrdReader(file.name).store())
    except (OSError, RuntimeError, ValueError):
        return 0
