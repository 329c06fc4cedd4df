# SPDX-License-Identifier: MIT
"""Record of the bags that the copies in a folder were made from."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from salsanext_cli.io.files.json_files import read_record, write_json
from salsanext_cli.io.formats.recordings import files_of
from salsanext_cli.runs.results.owned_folder import OwnedFolder


@dataclass(frozen=True, slots=True, kw_only=True)
class BagState:
    """State of a bag, by which a bag that was recorded further is recognised."""

    size: int  # Bytes of all its files
    time_ns: int  # Latest time of modification
    clouds: int  # Of the topics with results

    @classmethod
    def from_bag(cls, path: Path, clouds: int) -> "BagState":
        """Return the present state of a bag with a number of clouds."""
        statuses = [file.stat() for file in files_of(path)]
        return cls(
            size=sum(status.st_size for status in statuses),
            time_ns=max(status.st_mtime_ns for status in statuses),
            clouds=clouds,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _RecordedBags:
    """Content of the record."""

    stage: str
    bags: Mapping[str, BagState] = field(default_factory=dict)  # By the name of the copy


@dataclass(frozen=True, slots=True)
class BagSources:
    """States of the bags that a stage copied into a folder, in a hidden file of it."""

    owned: OwnedFolder

    @property
    def path(self) -> Path:
        """Path of the record."""
        return self.owned.root / f".{self.owned.stage}.bags.json"

    def state(self, name: str) -> BagState | None:
        """Return the state of the bag that a copy of a name was made from, if it is recorded."""
        return self._recorded().get(name)

    def record(self, name: str, state: BagState) -> None:
        """Record the state of the bag that a complete copy of a name was made from."""
        with self.owned.locked_records():
            bags = {**self._recorded(), name: state}
            write_json(self.path, _RecordedBags(stage=self.owned.stage, bags=bags))

    def _recorded(self) -> Mapping[str, BagState]:
        recorded = read_record(_RecordedBags, self.path)
        return recorded.bags if recorded else {}
