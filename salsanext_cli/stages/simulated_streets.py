# SPDX-License-Identifier: MIT
"""Simulated streets that a training draws samples from, beside the scans of its data set."""

import logging
from pathlib import Path

from salsanext_cli.classes import LabelSpace, label_space
from salsanext_cli.errors import NOTICE, counted
from salsanext_cli.sensors import Sensor
from salsanext_cli.stages.synth import LABEL_SPACE, synthesise
from salsanext_cli.storage.layout import find_scans
from salsanext_cli.synthesis.sensor.rig import RIGS
from salsanext_cli.training.data.sources import Source, further_source, merged_into

SCANS_OF_STREET, STREET_SPACING_M = 8, 10.0
"""Scans of a simulated street, and the distance between two."""

log = logging.getLogger(__name__)


def simulated_streets(
    folder: Path, count: int, classes: LabelSpace, sensor: Sensor, jobs: int
) -> list[Source]:
    """Return data sets of simulated streets, one per kind of sensor, made if they are not there.

    There are none for classes that they do not tell apart.

    Parameters
    ----------
    folder : Path
        Gets a data set per kind of sensor.
    count : int
        Streets of each data set.
    classes : LabelSpace
        Classes to train for.
    sensor : Sensor
        That the network is trained for.
    jobs : int
        Processes that simulate.
    """
    if not count:
        return []
    if merged_into(label_space(), classes) is None:
        log.log(NOTICE, "no simulated streets: they tell other classes apart than your labels")
        return []
    roots = {seen: folder / seen for seen in RIGS}
    for seen, root in roots.items():
        if not (root / LABEL_SPACE).exists() or len(find_scans(root)) != count * SCANS_OF_STREET:
            log.log(NOTICE, "simulating %s in %s", counted(count, "street"), root)
            synthesise(
                root,
                train=count,
                valid=0,
                scans=SCANS_OF_STREET,
                spacing=STREET_SPACING_M,
                sensor=seen,
                jobs=jobs,
                overwrite=True,
            )
    return [further_source(root, classes, sensor) for root in roots.values()]
