# SPDX-License-Identifier: MIT
"""Boxes of cars that are turned by 90°, in simulated streets, with predicted and with true labels.

The true direction is that of the body of each car. An object is a car's if most of its points are
on or near the body. A line for each kind of labels: number of objects, share that is turned by more
than 45° in %, without and with the rule for cars whose end alone is seen, median error in degrees.

Run: python benchmarks/box_yaw.py --sequences 60 --seed 202
"""

import argparse
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from salsanext_cli import label_space, load_network, project
from salsanext_cli.core.geometry.knn import knn_refine
from salsanext_cli.core.geometry.knn_parameters import KnnParameters
from salsanext_cli.core.geometry.objects import YAW, find_objects, fit_boxes
from salsanext_cli.synthesis.drive import record
from salsanext_cli.synthesis.lidar import Scene
from salsanext_cli.synthesis.mesh import Mesh

Array = npt.NDArray[np.float64]
SPACE = label_space()
CAR = SPACE.names.index("car")
CAR_IDS = (10, 252)  # Raw ids of standing and of moving cars
LENGTHS_M, WIDTHS_M = (3.0, 6.5), (1.3, 2.3)  # Sizes of bodies; wheels and mirrors are smaller
MARGIN_M = 0.4  # Distance from the body within which points are the car's
LEAST_SHARE = 0.7  # Least share of such points of an object


class Body(NamedTuple):
    """Upright rectangle around the body of a car, in the frame of the world."""

    centre: Array  # (2,) metres
    along: Array  # (2,) unit vector of its length
    half: Array  # (2,) metres: half of its length and width

    def share(self, flat: Array) -> float:
        """Return the share of points (N, 2) on or near the body."""
        across = np.array([-self.along[1], self.along[0]])
        own = np.abs((flat - self.centre) @ np.stack([self.along, across], axis=1))
        return float((own < self.half + MARGIN_M).all(axis=1).mean())


def bodies(mesh: Mesh) -> list[Body]:
    """Return the bodies of the cars in a mesh: its parts that have the size of one."""
    triangles = mesh.triangles[np.isin(mesh.labels, CAR_IDS)]
    pairs = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    size = len(mesh.vertices)
    links = coo_array((np.ones(len(pairs)), pairs.T), shape=(size, size))
    part_of = connected_components(links, directed=False)[1][triangles[:, 0]]
    found = []
    for part in np.unique(part_of):
        flat = mesh.vertices[np.unique(triangles[part_of == part]), :2]
        middle = flat.mean(axis=0)
        along = np.linalg.svd(flat - middle, full_matrices=False)[2][0]
        own = flat @ np.stack([along, [-along[1], along[0]]], axis=1)
        low, high = own.min(axis=0), own.max(axis=0)
        length, width = high - low
        if LENGTHS_M[0] < length < LENGTHS_M[1] and WIDTHS_M[0] < width < WIDTHS_M[1]:
            turn = np.stack([along, [-along[1], along[0]]])
            found.append(Body((low + high) / 2 @ turn, along, (high - low) / 2))
    return found


def error_deg(yaw: float, along: Array) -> float:
    """Return the angle between a box and a body, 0 to 90 degrees."""
    cosine = abs(np.cos(yaw) * along[0] + np.sin(yaw) * along[1])
    return float(np.degrees(np.arccos(min(cosine, 1.0))))


def main(*words: str) -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--sequences", type=int, default=60)
    parser.add_argument("--seed", type=int, default=202)
    parser.add_argument("--weights", type=Path)
    given = parser.parse_args(words or None)
    network = load_network(given.weights, "cpu")
    errors: dict[str, list[tuple[float, float]]] = {"predicted": [], "true": []}
    for sequence in range(given.sequences):
        meshes: list[Mesh] = []

        def scene_of(mesh: Mesh, meshes: list[Mesh] = meshes) -> Scene:
            meshes.append(mesh)
            return Scene(mesh)

        (frame,) = record(given.seed, sequence, 1, 1.0, make_scene=scene_of)
        cars = [body for mesh in meshes for body in bodies(mesh)]
        image = project(frame.scan, network.sensor)
        pixels = network.predict([network.input(image.channels)])[0].labels
        predicted = knn_refine(image, pixels, SPACE.class_count, KnnParameters())
        truth = SPACE.to_train(frame.labels, strict=False)
        world = (frame.scan.points @ frame.pose[:3, :3].T + frame.pose[:3, 3]).astype(np.float32)
        for kind, labels in (("predicted", predicted), ("true", truth)):
            objects = find_objects(image, labels, SPACE.movable)
            for number in np.unique(objects[(objects > 0) & (labels == CAR)]):
                points = world[objects == number]
                shares = [body.share(points[:, :2]) for body in cars]
                if not shares or max(shares) < LEAST_SHARE:
                    continue
                along = cars[int(np.argmax(shares))].along
                one, position = np.ones(len(points), np.uint16), frame.pose[:2, 3]
                both = (
                    fit_boxes(points, one, np.array([rule]), position)[0] for rule in (False, True)
                )
                errors[kind].append(tuple(error_deg(box[YAW], along) for box in both))
    for kind, pairs in errors.items():
        before, after = np.array(pairs).reshape(-1, 2).T
        shares = [100 * (values > 45).mean() for values in (before, after) if len(values)]
        turned = " → ".join(f"{share:.1f} %" for share in shares)
        medians = " → ".join(f"{np.median(v):.1f}°" for v in (before, after) if len(v))
        print(
            f"{kind} labels  {len(before)} objects  turned {turned}  median {medians}", flush=True
        )


if __name__ == "__main__":
    main()
