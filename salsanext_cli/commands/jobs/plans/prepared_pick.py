# SPDX-License-Identifier: MIT
"""What `pick` decides before the first scan: scans to choose from, network, settings."""

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import NoInputError, UsageError
from salsanext_cli.core.measures.scan_choice import require_choice
from salsanext_cli.core.uncertainty.monte_carlo import require_sampling
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.atomic import foresee_writable
from salsanext_cli.runs.annotation.picked_data_set import (
    CHOSEN,
    NAMED,
    PickedDataSet,
    PickRecord,
    PickSettings,
)
from salsanext_cli.runs.fit.scan_sample import sample_of_files
from salsanext_cli.runs.fit.sensor_fit import fit_scans, settings_of_network
from salsanext_cli.runs.loop.run_origins import OriginsOfSource
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.records.stage_settings import ComputedSettings
from salsanext_cli.runs.scans.named_scans import named_scans, read_names
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_search import find_scans
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import choose, evenly_spaced, scans_of, space_of

SAMPLES = 8  # Passes of Monte-Carlo dropout, with the same masks for all scans


@dataclass(frozen=True, slots=True, kw_only=True)
class PreparedPick:
    """Choice of scans before the first scan is described."""

    data_set: PickedDataSet
    listed: Sequence[ScanFile]  # All scans of the source
    scans: Sequence[ScanFile]  # Those to choose from
    labelled: set[ScanFile]  # Those of them that are labelled already
    space: LabelSpace  # Classes of the scans
    network: Network  # Fitted to the scans
    origins: OriginsOfSource  # Origins of registered scans
    settings: PickSettings  # Settings to record

    @property
    def count(self) -> int:
        """Number of scans that are picked if all scans can be read."""
        return min(self.settings.count, len(self.scans) - len(self.labelled))

    def files(self, record: PickRecord) -> list[ScanFile]:
        """Return the picked scans of a record that are among those to choose from."""
        files = {scan.name: scan for scan in self.scans}
        return [files[scan.name] for scan in record.picked if scan.name in files]


def prepare_pick(
    source: Path,
    out: Path,
    *,
    count: int,
    seed: int,
    settings: NetworkSettings,
    selection: ScanSelection,
    labelled: Sequence[Path],
    names: Path | None,
) -> PreparedPick:
    """Load and fit the network, and find the scans; arguments as of `pick`."""
    require_choice(count, seed)
    foresee_writable(out)
    network = settings.for_sampling().load()
    require_sampling(network, SAMPLES)
    listed = scans_of(source)
    data_set = PickedDataSet(out)
    data_set.require_apart(listed)
    space = space_of(listed, network.space)
    selected = choose(listed, replace(selection, limit=None), space, source)
    scans = _candidates(selected, selection, labelled, names)
    done = _done(scans, labelled, source)
    origins = OriginsOfSource(listed=listed)
    sample = sample_of_files(listed, network.sensor, origins_of=origins.sample_origins)
    network = fit_scans(settings, network, sample)
    recorded = PickSettings(
        network=settings_of_network(network, ComputedSettings),
        count=count if names is None else len(scans),
        seed=seed,
        scans=_digest(scans),
        labelled=_digest(sorted(done)) if labelled else None,
        samples=SAMPLES,
        strategy=CHOSEN if names is None else NAMED,
    )
    return PreparedPick(
        data_set=data_set,
        listed=listed,
        scans=scans,
        labelled=done,
        space=space,
        network=network,
        origins=origins,
        settings=recorded,
    )


def _done(scans: Sequence[ScanFile], labelled: Sequence[Path], source: Path) -> set[ScanFile]:
    """Return the scans that the data sets of labelled scans contain; refuse if all are."""
    labelled_names = {scan.name for path in labelled for scan in find_scans(path)}
    done = {scan for scan in scans if scan.name in labelled_names}
    if len(done) == len(scans):
        raise NoInputError(source, "has only labelled scans", "others to pick")
    return done


def _candidates(
    scans: Sequence[ScanFile],
    selection: ScanSelection,
    labelled: Sequence[Path],
    names: Path | None,
) -> list[ScanFile]:
    """Return the scans of a list of names, else evenly spaced ones.

    Options that choose scans too are refused beside a list.
    """
    if names is None:
        return evenly_spaced(scans, selection.limit or 0)
    if selection.limit:
        raise _chooses_too("selection.limit")
    if labelled:
        raise _chooses_too("labelled")
    return named_scans(read_names(names), scans, str(names))


def _chooses_too(name: str) -> UsageError:
    """Return the error of an argument beside a list of names."""
    problem = f"chooses scans, and so does {argument('names')}"
    return UsageError(argument(name), problem, "one of both")


def _digest(scans: Sequence[ScanFile]) -> str:
    """Return the number of scans and a digest of their names and places."""
    names = "\n".join(f"{scan.name} {scan.path}" for scan in scans)
    digest = hashlib.sha256(names.encode("utf-8", "surrogateescape")).hexdigest()
    return f"{len(scans)}, {digest[:16]}"
