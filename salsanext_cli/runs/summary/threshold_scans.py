# SPDX-License-Identifier: MIT
"""Whether scans are like those that a threshold of risk was chosen on."""

from __future__ import annotations

import hashlib
import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.fitting.view_fit import is_other_view
from salsanext_cli.core.measures.population import (
    are_comparable,
    have_measures,
    new_codes,
    population_difference,
    traits_of_units,
)
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import data_set_of

NOT_COMPARED = "the scans cannot be compared with those that the threshold was chosen on"
TUNE_AGAIN_HINT = "choose the threshold with `salsanext tune risk` on labelled scans like these"
UNLIKE = "the scans differ from those that the threshold was chosen on"
EARLY = "the threshold was chosen by an earlier version, which did not record the sensor"
log = logging.getLogger(__name__)
MAX_COMPARED = 5000  # Most scans that are compared with those of a threshold


@dataclass(slots=True, kw_only=True)
class TraitSample:
    """Traits of at most `MAX_COMPARED` scans of a run, which are chosen by their names.

    The digests of the names decide, so that the scans are of all drives, and the same ones in
    whatever order workers finish them.
    """

    traits: dict[str, UnitTraits] = field(default_factory=dict)  # By name; twice as many at most

    def add(self, name: str, traits: UnitTraits) -> None:
        """Add the traits of a scan."""
        self.traits[name] = traits
        if len(self.traits) >= 2 * MAX_COMPARED:
            self.traits = self.chosen()

    def chosen(self) -> dict[str, UnitTraits]:
        """Return the traits of the chosen scans by name."""
        names = sorted(self.traits, key=_digest)[:MAX_COMPARED]
        return {name: self.traits[name] for name in names}


@dataclass(frozen=True, slots=True, kw_only=True)
class ThresholdComparison:
    """Scans of a run, to be compared with those of a threshold."""

    files: Sequence[ScanFile]
    sensor: Sensor  # Sensor that the scans were projected for
    traits: Mapping[str, UnitTraits]  # By name of the scan
    classes: Sequence[str]  # Names of the classes from train id 1 on

    def finding(self, risk: RiskThreshold) -> Finding | None:
        """Return the warning that scans are unlike those of a threshold; None without evidence.

        If they cannot be compared, a line says so.
        """
        problem = self.difference(risk)
        if problem:
            return Finding(WarningCode.OTHER_SCANS, problem, TUNE_AGAIN_HINT)
        reason = why_incomparable(risk, self.units(risk)) if self.traits else ""
        if reason:
            log.log(NOTICE, "%s (%s)", NOT_COMPARED, reason)
        return None

    def difference(self, risk: RiskThreshold) -> str:
        """Return the evidence that the scans are unlike those of a threshold, else no text."""
        problem = self._other_drives(risk) or self._other_view(risk)
        if problem:
            return f"{UNLIKE}: {problem}"
        # Workers finish in any order. The comparison draws at random from the scans in their order.
        names = sorted(self.traits)
        population = tuple(self.traits[name] for name in names)
        if not population or not risk.population:
            return ""
        if risk.unit == "drive":
            population = traits_of_units(population, [_sequence_of(name) for name in names])
        codes = new_codes(risk.population, population) if have_measures(risk.population) else []
        if codes:
            return f"{UNLIKE}: they have the warning {first_few(codes)}"
        difference = population_difference(risk.population, population, self.classes)
        return f"{UNLIKE}: {difference}" if difference else ""

    def units(self, risk: RiskThreshold) -> int:
        """Return the number of scans or drives, as the guarantee of a threshold counts them."""
        if risk.unit == "scan":
            return len(self.traits)
        return len({_sequence_of(name) for name in self.traits})

    def _other_drives(self, risk: RiskThreshold) -> str:
        """Return data set or drives that a guarantee about scans of named drives does not cover."""
        if risk.unit == "drive" or not self.files:
            return ""
        if risk.data_set:
            data_sets = {_data_set(file) for file in self.files}
            other_data_sets = sorted(data_sets - {risk.data_set})
            if other_data_sets:
                return f"they are of {first_few(other_data_sets)}, not of {risk.data_set}"
        sequences = {file.sequence for file in self.files}
        other_sequences = sorted(sequences - set(risk.sequences))
        if other_sequences:
            return f"they are of {first_few(other_sequences)}, not of {first_few(risk.sequences)}"
        return ""

    def _other_view(self, risk: RiskThreshold) -> str:
        """Return the difference of a sensor whose field of view is unlike all of the threshold."""
        if not risk.views:
            return ""
        for sensor in self.sensor.members:
            if all(is_other_view(view, sensor) for view in risk.views):
                return "another field of view"
        return ""


def _digest(name: str) -> bytes:
    """Return a digest of the name of a scan, which may be no valid text."""
    return hashlib.sha256(name.encode(errors="surrogateescape")).digest()


def _sequence_of(name: str) -> str:
    """Return the sequence in the name of a scan, such as 08 of 08/000000."""
    return name.rpartition("/")[0]


def _data_set(file: ScanFile) -> str:
    """Return the name of the folder of the data set of a scan, else of its own folder."""
    return (data_set_of(file) or file.path.parent).resolve().name


def why_incomparable(risk: RiskThreshold, units: int) -> str:
    """Return why a comparison of so many scans or drives with a threshold shows nothing, or "".

    Parameters
    ----------
    risk : RiskThreshold
        Threshold and the scans that it was chosen on.
    units : int
        Number of scans, or of drives if these are the units of the guarantee.

    Returns
    -------
    str
    """
    if not risk.population or not have_measures(risk.population):
        return EARLY
    if not are_comparable(len(risk.population), units):
        return counted(units, risk.unit)
    return ""
