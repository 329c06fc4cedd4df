# SPDX-License-Identifier: MIT
"""`salsanext picture`."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from salsanext_cli.commands.line.options import declarations
from salsanext_cli.commands.line.options.expansion import Without
from salsanext_cli.commands.line.options.option_fields import argument, option
from salsanext_cli.commands.line.options.typer_interface import is_typed
from salsanext_cli.commands.line.output import console, summary
from salsanext_cli.commands.line.output.next_command import next_command
from salsanext_cli.commands.line.output.progress import over_results, over_scans
from salsanext_cli.commands.line.values.results_of_pick import results_in
from salsanext_cli.commands.line.values.scans_and_out import scans_and_out
from salsanext_cli.commands.line.values.typed_values import typed_position
from salsanext_cli.core.errors import UsageError
from salsanext_cli.runs.loop.run_options import RunOptions
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.query import ResultQuery

if TYPE_CHECKING:
    from salsanext_cli.commands.stages.picture import PictureOutcome

UNUSED_SETTINGS = ("weights", "device", "precision", "engine", "min_range", "ego", "intensity")
"""Fields of `NetworkSettings` that pictures of scans do not depend on."""

RESULTS_OR_SCANS = argument(
    "Folder with results; or a scan file, folder of scans, sequence folder, data set or recording, "
    "of which several may be given.",
    metavar="OUT|SCANS...",
    show_default="out",
)
PICTURES_OUT = declarations.folder_argument("Folder for the pictures of scans.")


def picture(
    context: typer.Context,
    source: Path | None = RESULTS_OR_SCANS,
    out: Path = PICTURES_OUT,
    *,
    colour: list[str] | None = option(
        f"height, {declarations.COLOUR_HELP}; may be given several times.",
        "--colour",
        "--color",
        show_default="all that are available",
    ),
    scale: tuple[float, float] | None = declarations.SCALE,
    query: ResultQuery,
    topic: str | None = declarations.TOPIC,
    settings: Annotated[declarations.Network, Without(UNUSED_SETTINGS)],
    origin: str | None = declarations.ORIGIN,
    running: RunOptions,
    output: console.Output,
) -> None:
    """Draw scans and their results, from above and as range images, as PNG.

    Scans need no results: height, intensity and range show what a file contains.

    Example: salsanext picture scan.pcd
    """
    from salsanext_cli.commands.stages.picture import picture as picture_results
    from salsanext_cli.commands.stages.picture import picture_scans
    from salsanext_cli.runs.results.result_folder import is_result_folder

    colours = colour or ()
    if source is None or is_result_folder(results_in(source)):
        results = results_in(out if source is None else source)
        _refuse_second_path(context, out, results)
        _refuse_options_of_scans(settings, origin, topic, results)
        with over_results("picture", running, output.quiet) as options:
            outcome = picture_results(
                results, colours=colours, scale=scale, query=query, options=options
            )
        summary.print_summary_and_exit("picture", outcome, results, output)
    else:
        places = scans_and_out(context, source, out, query.dataset, topic)
        with over_scans("picture", running, output.quiet) as options:
            outcome = picture_scans(
                places.scans,
                places.out,
                colours=colours,
                scale=scale,
                settings=settings,
                origin=typed_position("--origin", origin),
                query=query,
                options=options,
            )
        sources = places.scans if isinstance(places.scans, list) else [source]
        options_of_scans = _typed_options(settings, origin, topic)
        following = next_command(outcome, ["predict", *sources, places.out, *options_of_scans])
        summary.print_summary_and_exit(
            "picture", outcome, places.out, output, following=following, numbers=_numbers(outcome)
        )


def _typed_options(settings: NetworkSettings, origin: str | None, topic: str | None) -> list[str]:
    """Return the options about the scans that were typed, with their values."""
    values = {**settings.named(), "origin": origin, "topic": topic}
    words: list[str] = []
    for name, value in values.items():
        if value is not None:
            words += [f"--{name.replace('_', '-')}", str(value)]
    return words


def _refuse_second_path(context: typer.Context, out: Path, results: Path) -> None:
    """Refuse a second path after a folder with results, whose pictures go into it."""
    if is_typed(context, "out"):
        problem = f"{out} follows {results}, which has results"
        raise UsageError("OUT", problem, "one folder with results, or scans and a folder")


def _refuse_options_of_scans(
    settings: NetworkSettings, origin: str | None, topic: str | None, results: Path
) -> None:
    """Refuse options about scans for pictures of results, which record their scans."""
    typed = _typed_options(settings, origin, topic)
    if typed:
        problem = f"{results} has results, whose record states how its scans are read"
        hint = "give the scans instead of their results"
        raise UsageError(typed[0], problem, "no option about the scans", hint)


def _numbers(outcome: "PictureOutcome") -> summary.StageNumbers:
    """Return what the pictures of scans show, as plain data and in words."""
    from salsanext_cli.core.fitting.sensor_texts import image_text
    from salsanext_cli.core.sensors.sensor import NOISE
    from salsanext_cli.report.scan_pictures import UNITS

    ends = [
        _scale_text(
            outcome.ranges.get(colour), outcome.scales.get(colour), colour, UNITS.get(colour, "")
        )
        for colour in outcome.ranges | outcome.scales
    ]
    images = dict.fromkeys(image_text(member) for member in outcome.sensor.members)
    lines = [f"image: {image}" for image in images]
    lines.append(f"colours: {'; '.join(ends)}")
    lines.append(f"first picture: {outcome.first}")
    data = {
        "sensor": outcome.sensor.to_dict(NOISE),
        "scales": outcome.scales,
        "ranges": outcome.ranges,
        "first": str(outcome.first),
    }
    # No scan has a picture if all of them failed.
    return summary.StageNumbers(data=data, lines=lines if outcome.has_results else ())


def _scale_text(
    values: Sequence[float] | None, scale: Sequence[float] | None, colour: str, unit: str
) -> str:
    """Describe the values of a colour, and its scale if that differs from their range.

    ``height -1.9 to 3.2 m``, or ``height -1.9 to 3.2 m (scale 0 to 12 m)``.
    """
    texts = [_range_text(ends, unit) for ends in (values, scale) if ends is not None]
    if len({*texts}) == 1:
        return f"{colour} {texts[0]}"
    return f"{colour} {texts[0]} (scale {texts[1]})"


def _range_text(ends: Sequence[float], unit: str) -> str:
    """Describe the ends of a range of values with their unit."""
    low = ends[0]
    high = ends[-1]
    values = f"{low:.3g} at most points" if low == high else f"{low:.3g} to {high:.3g}"
    return f"{values} {unit}".strip()
