# SPDX-License-Identifier: MIT
"""The way of one scan by the CPU kernels: sensor, checks, range image, labels of pixels, of points.

`core.labellers` takes these steps, or those of a device: reader threads prepare scans, a device
predicts batches of them, and a writer thread refines their labels.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from salsanext_cli.core.checks.scan_checks import ScanCheck, check_scan
from salsanext_cli.core.classes.label_space import TrainIds
from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.geometry.knn import knn_refine
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.projection import points_from_pixels, project
from salsanext_cli.core.geometry.sensor_frame import ego_points, in_sensor_frame
from salsanext_cli.core.geometry.sensor_of_scan import origin_of_scan, sensor_of
from salsanext_cli.core.records import Float, Origin, RangeImage, Scan
from salsanext_cli.core.sensors.sensor import Sensor


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelRequest:
    """Results of a scan besides its labels and their least confidence.

    Attributes
    ----------
    knn : KnnParameters
        Neighbourhood of the refinement.
    softmax : bool
        Whether the points have the probabilities of all classes.
    half_softmax : bool
        Whether these are float16, as files contain them, instead of float32.
    error : bool
        Whether the points have the probability that their label is wrong, which needs an error
        model in the weights.
    """

    knn: KnnParameters = KnnParameters()
    softmax: bool = False
    half_softmax: bool = False
    error: bool = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CheckedScan:
    """Scan whose sensor was found, and that was checked.

    Attributes
    ----------
    source : object
        Name of the scan in errors, such as the path of its file.
    scan : Scan
        N points, in the frame of their file.
    sensor : Sensor
        Member of the fitted sensor that the scan belongs to.
    origin : tuple of float, optional
        Position by which the member was found; None if no scan has its own.
    check : ScanCheck
        Reasons to doubt the scan.
    """

    source: object
    scan: Scan
    sensor: Sensor
    origin: Origin | None
    check: ScanCheck

    def range_image(self) -> RangeImage:
        """Return the range image, H × W pixels; the kernels project a scan without one."""
        return project(self.scan, self.sensor)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ProjectedScan(CheckedScan):
    """Scan that was checked and projected.

    Attributes
    ----------
    image : RangeImage
        H × W pixels.
    """

    image: RangeImage

    def range_image(self) -> RangeImage:
        """Return the range image."""
        return self.image


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PreparedScan:
    """Scan that is ready for a network.

    Attributes
    ----------
    projected : ProjectedScan
        Checked and projected scan.
    network : Network
        Network for the sensor of the scan.
    input : (1, 5, H, W) float32
        Normalised range image.
    """

    projected: ProjectedScan
    network: Network
    input: Float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LabelledScan:
    """Scan with the labels of a network.

    Attributes
    ----------
    checked : CheckedScan
        Scan of N points.
    labels : (N,) uint8
        Train ids of the points, refined by kNN.
    least_confidence : (N,) float32
        1 minus the largest probability of the pixel of each point; NaN without a pixel.
    pixel_labels : (H, W) uint8
        Train ids of the pixels.
    mean_confidence : float
        Mean of the largest probabilities of the occupied pixels, 0…1; 1 without any.
    softmax : (N, C) float32 or float16, optional
        Probabilities of all classes of the pixel of each point, class 0 without a pixel.
    error : (N,) float32, optional
        Probability that each label is wrong; NaN without a pixel.
    """

    checked: CheckedScan
    labels: TrainIds
    least_confidence: Float
    pixel_labels: TrainIds
    mean_confidence: float
    softmax: Float | None = None
    error: Float | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EstimatedScan:
    """Scan with the uncertainty of its points.

    Attributes
    ----------
    checked : CheckedScan
        Scan of N points.
    uncertainty : dict of (N,) float32
        Each kind of the method by its name; NaN without a pixel.
    labels : (N,) uint8, optional
        Train ids of the points by the mean softmax, refined by kNN.
    error : (N,) float32, optional
        Probability that each label is wrong; NaN without a pixel.
    """

    checked: CheckedScan
    uncertainty: dict[str, Float]
    labels: TrainIds | None = None
    error: Float | None = None


def checked_scan(
    scan: Scan,
    sensor: Sensor,
    trained: Sensor | None = None,
    origin: Origin | None = None,
    source: object = "scan",
) -> CheckedScan:
    """Find the sensor of a scan and check its points; the parameters are as of `project_scan`."""
    origin = origin_of_scan(scan, sensor, origin)
    sensor = sensor_of(scan, sensor, origin)
    check = replace(check_scan(source, scan, sensor, trained), points=len(scan))
    return CheckedScan(source=source, scan=scan, sensor=sensor, origin=origin, check=check)


def project_scan(
    scan: Scan,
    sensor: Sensor,
    trained: Sensor | None = None,
    origin: Origin | None = None,
    source: object = "scan",
) -> ProjectedScan:
    """Find the sensor of a scan, check its points and project them.

    Parameters
    ----------
    scan : Scan
        N points, in the frame of their file.
    sensor : Sensor
        Sensor that was fitted to such scans, perhaps with several members.
    trained : Sensor, optional
        Sensor of the weights, if the intensity matters.
    origin : 3 floats, optional
        Position of the sensor in the scan in metres, if it is known.
    source : object
        Name of the scan in errors.

    Returns
    -------
    ProjectedScan

    Raises
    ------
    FormatError
        If the points are not those of a scan in metres around a sensor.
    """
    checked = checked_scan(scan, sensor, trained, origin, source)
    image = project(scan, checked.sensor)
    ego_count = _ego_count(scan, image, checked.sensor)
    return ProjectedScan(
        source=source,
        scan=scan,
        sensor=checked.sensor,
        origin=checked.origin,
        check=replace(checked.check, ego_points=ego_count),
        image=image,
    )


def _ego_count(scan: Scan, image: RangeImage, sensor: Sensor) -> int:
    """Count the points of a scan on the housing of its sensor or its vehicle."""
    without_pixel = scan.take(np.flatnonzero(image.pixel_of_point < 0))
    return len(ego_points(in_sensor_frame(without_pixel, sensor).points, sensor))


def prepare_for(network: Network, projected: ProjectedScan) -> PreparedScan:
    """Return a projected scan with its input of a network, whose sensor may have members."""
    network = network.for_sensor(projected.sensor)
    return PreparedScan(
        projected=projected, network=network, input=network.input(projected.image.channels)
    )


def predict_pixels(
    network: Network, scans: Sequence[PreparedScan], *, softmax: bool = False
) -> list[PixelPrediction]:
    """Predict the pixels of scans together.

    Parameters
    ----------
    network : Network
        Network of the scans.
    scans : sequence of PreparedScan
        Scans that are ready for it.
    softmax : bool
        Whether the predictions have the probabilities of all classes.

    Returns
    -------
    list of PixelPrediction
    """
    return network.predict([scan.input for scan in scans], softmax=softmax)


def refine_labels(
    prepared: PreparedScan, pixels: PixelPrediction, knn: KnnParameters
) -> LabelledScan:
    """Refine the labels of the pixels of a scan to labels of its points.

    Parameters
    ----------
    prepared : PreparedScan
        Scan of N points.
    pixels : PixelPrediction
        Labels of its pixels.
    knn : KnnParameters
        Neighbourhood.

    Returns
    -------
    LabelledScan

    Raises
    ------
    WeightsError
        If a probability is not finite.
    """
    projected = prepared.projected
    network = prepared.network
    network.backend.require_finite(pixels.confidence, projected.source)
    image = projected.image
    confidence = pixels.confidence[image.channels[0] > 0]
    return LabelledScan(
        checked=projected,
        labels=knn_refine(image, pixels.labels, network.space.class_count, knn),
        least_confidence=points_from_pixels(1 - pixels.confidence, image.pixel_of_point, np.nan),
        pixel_labels=pixels.labels,
        mean_confidence=float(confidence.mean()) if len(confidence) else 1.0,
    )
