"""How far the arm stays from itself and from the ground: Pinocchio's kinematics, coal's distances.

The geometry is the URDF's collision geometry (or, lacking that, its visual one); meshes count as their convex hulls,
which hold more than they do. Where a URDF has none, or its meshes cannot be found or have no convex hull, links are
capsules from joint to joint. Links that one joint connects are not checked against each other, nor pairs that overlap
in nearly every posture: their geometry is coarser than the arm. Both are listed.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import coal
import numpy as np
import pinocchio as pin

from ..arrays import FloatArray
from ..dynamics.arm import Arm
from ..dynamics.frames import Frames, frames_of
from ..dynamics.meshes import resolve_meshes
from ..dynamics.regressor import cross

NEEDED_M = 0.02
"""Least distance: what a coarse geometry and a servo's lag may take up."""
GROUND = "ground"
CAPSULE_SHARE = 0.04
"""Radius of a capsule as a share of the arm's stretched length, where the URDF has no geometry."""
_SAMPLES = 200
_OVERLAP = 0.95
_RIGID_M = 1e-6
"""Pairs whose distance no posture changes by more need no watching."""
_FLAT_M = 1e-6
"""Thickness up to which a mesh counts as flat: coal's hull of 0.1 µm is sound, that of 1 nm ends the process."""


@dataclass(frozen=True)
class Nearest:
    """The least distance of one pair: m, where it is reached (row), and the pair."""

    distance_m: float
    row: int
    pair: tuple[str, str]


class Clearance:
    """Distances between an arm's links, and from its links to the ground.

    Attributes:
        needed_m: Least distance allowed.
        source: Where the geometry comes from, in words.
        lacking: Why capsules stand in for the URDF's geometry; empty where they do not.
        pairs: Names of the links of every pair checked.
        unchecked: Pairs left out because they overlap in nearly every posture.
    """

    def __init__(
        self, arm: Arm, ground_m: float | None, lower: FloatArray, upper: FloatArray, needed_m: float = NEEDED_M
    ) -> None:
        """Args: `ground_m` is the height of the floor, base frame; the limits (n,) are where postures are sampled."""
        self.needed_m = needed_m
        self._arm = arm
        self._model = pin.buildModelFromXML(arm.urdf)
        self._data = self._model.createData()
        self._neutral = pin.neutral(self._model)
        self._geometry, self.source, self.lacking = _geometry(arm, self._model)
        self._joint_of = [g.parentJoint for g in self._geometry.geometryObjects]
        self._label = [_link_name(self._model, g) for g in self._geometry.geometryObjects]
        if ground_m is not None:
            self._add_ground(ground_m)
        self._add_pairs()
        self._geometry_data = pin.GeometryData(self._geometry)
        self.unchecked = self._drop_overlapping(lower, upper)
        self.pairs = [self._names(pair) for pair in self._geometry.collisionPairs]
        self._turns = np.array([joint.revolute for joint in arm.joints])
        self._carries = np.zeros((len(arm.joints) + 1, len(arm.joints)))
        for link in range(len(arm.joints)):
            self._carries[link + 1, list(arm.supports(link))] = 1.0
        ends = [(self._joint_of[pair.first], self._joint_of[pair.second]) for pair in self._geometry.collisionPairs]
        self._ends = np.array(ends, dtype=np.intp).reshape(-1, 2)
        self._bounds = _Spheres(self._geometry)

    def _add_ground(self, height: float) -> None:
        shape = coal.Halfspace(np.array([0.0, 0.0, 1.0]), float(height))
        self._geometry.addGeometryObject(pin.GeometryObject(GROUND, 0, 0, pin.SE3.Identity(), shape))
        self._joint_of.append(0)
        self._label.append(GROUND)

    def _add_pairs(self) -> None:
        count, parents = len(self._joint_of), self._model.parents
        for i in range(count):
            for j in range(i + 1, count):
                a, b = self._joint_of[i], self._joint_of[j]
                grounded = GROUND in (self._label[i], self._label[j])
                if a != b and (grounded or (parents[a] != b and parents[b] != a)):
                    self._geometry.addCollisionPair(pin.CollisionPair(i, j))

    def _drop_overlapping(self, lower: FloatArray, upper: FloatArray) -> list[tuple[str, str]]:
        low, high = np.maximum(lower, -np.pi), np.minimum(upper, np.pi)
        postures = np.random.default_rng(0).uniform(low, high, (_SAMPLES, len(low)))
        distances = self.distances(postures)
        # Capsules on either side of a short link keep one distance in many postures: rounding must not decide.
        overlap = (distances < self.needed_m + _RIGID_M).mean(axis=0) > _OVERLAP
        rigid = np.ptp(distances, axis=0) < _RIGID_M
        pairs = [pair.copy() for pair in self._geometry.collisionPairs]
        for pair, bad in zip(pairs, overlap | rigid):
            if bad:
                self._geometry.removeCollisionPair(pair)
        self._geometry_data = pin.GeometryData(self._geometry)
        return sorted({self._names(pair) for pair, bad in zip(pairs, overlap & ~rigid) if bad})

    def _names(self, pair: Any) -> tuple[str, str]:
        return self._label[pair.first], self._label[pair.second]

    def _place(self, posture: FloatArray) -> None:
        configuration = pin.integrate(self._model, self._neutral, posture)
        pin.updateGeometryPlacements(self._model, self._data, self._geometry, self._geometry_data, configuration)

    def _measured(self, pairs: Sequence[int]) -> FloatArray:
        """(P,) m between pairs, by their numbers, in the posture placed."""
        measure, geometry, data = pin.computeDistance, self._geometry, self._geometry_data
        return np.array([measure(geometry, data, pair).min_distance for pair in pairs])

    def distances(self, postures: FloatArray) -> FloatArray:
        """(T, pairs) m, negative where they overlap, at `postures` (T, n)."""
        out = np.empty((len(postures), len(self._geometry.collisionPairs)))
        for row, posture in enumerate(postures):
            self._place(posture)
            pin.computeDistances(self._geometry, self._geometry_data)
            out[row] = [result.min_distance for result in self._geometry_data.distanceResults]
        return out

    def nearest(self, postures: FloatArray) -> Nearest | None:
        """The least distance along `postures` (T, n); None where there is nothing to check.

        Pairs are measured in the order of their spheres' distance, until that exceeds the least measured.
        """
        if not self.pairs:
            return None
        apart = self._bounds.distances(frames_of(self._arm, postures))
        least, at = np.inf, (0, 0)
        for row, pair in zip(*(k.tolist() for k in np.unravel_index(np.argsort(apart, axis=None), apart.shape))):
            if apart[row, pair] >= least:
                break
            self._place(postures[row])
            distance = float(self._measured([pair])[0])
            if distance < least:
                least, at = distance, (row, pair)
        return Nearest(least, at[0], self.pairs[at[1]])

    def barrier(self, postures: FloatArray, reach_m: float, slopes: bool = True) -> tuple[float, FloatArray]:
        """A barrier on all distances, and its derivative (T, n) by the postures.

        Sum over postures and pairs of s − 1 − log s, s = (distance − needed) / reach: zero with zero slope beyond
        `reach_m`, infinite from the needed distance on. Pairs whose spheres are farther apart are not measured.

        Args:
            postures: (T, n) rad or m.
            reach_m: Distance beyond the needed one at which the barrier begins, m.
            slopes: Whether to compute the derivative. It is zero otherwise, and where the barrier is infinite.
        """
        slope = np.zeros_like(postures)
        frames = frames_of(self._arm, postures)
        within = self._bounds.distances(frames) < self.needed_m + reach_m
        rows, pairs, shares, ends = [], [], [], []
        for row in np.flatnonzero(within.any(axis=1)).tolist():
            candidates = np.flatnonzero(within[row])
            self._place(postures[row])
            share = (self._measured(candidates.tolist()) - self.needed_m) / reach_m
            if (share <= 0.0).any():
                return float("inf"), slope
            for pair, own in zip(candidates[share < 1.0].tolist(), share[share < 1.0].tolist()):
                result = self._geometry_data.distanceResults[pair]
                rows.append(row)
                pairs.append(pair)
                shares.append(own)
                ends.append((result.getNearestPoint1(), result.getNearestPoint2()))
        near = np.array(shares)
        if slopes and len(near):
            approach = self._approach(frames, np.array(rows), np.array(pairs), np.array(ends))
            np.add.at(slope, rows, ((1.0 - 1.0 / near) / reach_m)[:, None] * approach)
        return float((near - 1.0 - np.log(near)).sum()), slope

    def _approach(self, frames: Frames, rows: np.ndarray, pairs: np.ndarray, ends: FloatArray) -> FloatArray:
        """Derivatives of pairs' distances by the posture: how the nearest points move along their line.

        A point p of a link moves with joint k by axis × (p − origin) where k carries the link, by axis where it
        slides; along the line l that is axis · ((p − origin) × l).

        Args:
            frames: Of the postures.
            rows: (P,) posture of each pair.
            pairs: (P,) numbers.
            ends: (P, 2, 3) nearest points in the base frame, of the pair's first and second geometry.

        Returns:
            (P, n).
        """
        one, other = ends[:, 0].T, ends[:, 1].T
        line = other - one
        line = (line / np.maximum(np.linalg.norm(line, axis=0), 1e-12))[:, None]
        turns, spots = zip(*frames[1:])
        axes = np.stack([turn[..., rows].swapaxes(1, 2) @ j.axis for turn, j in zip(turns, self._arm.joints)], axis=1)
        origins = np.stack([spot[:, rows] for spot in spots], axis=1)
        out = np.zeros(axes.shape[1:])
        for sign, points, side in ((1.0, other, 1), (-1.0, one, 0)):
            lever = cross(points[:, None] - origins, line)
            moved = (axes * np.where(self._turns[:, None], lever, line)).sum(axis=0)
            out += sign * self._carries[self._ends[pairs, side]].T * moved
        return out.T


class _Spheres:
    """Spheres about the geometries: what lies between two of them is a lower bound of a pair's distance."""

    def __init__(self, geometry: pin.GeometryModel) -> None:
        centres, radii, joints, floor = [], [], [], []
        for entry in geometry.geometryObjects:
            shape = entry.geometry
            shape.computeLocalAABB()
            grounded = isinstance(shape, coal.Halfspace)
            centres.append(np.zeros(3) if grounded else entry.placement.act(np.array(shape.aabb_center)))
            radii.append(0.0 if grounded else float(shape.aabb_radius))
            joints.append(entry.parentJoint)
            floor.append(float(shape.d) if grounded else np.nan)
        self._centres, self._joints = np.array(centres).reshape(-1, 3), np.array(joints, dtype=np.intp)
        pairs = np.array([(pair.first, pair.second) for pair in geometry.collisionPairs], dtype=np.intp).reshape(-1, 2)
        self._one, self._other = pairs.T
        self._touching = np.array(radii)[pairs].sum(axis=1)[:, None]
        self._floor = np.fmax(*np.array(floor)[pairs].T)
        # Either may be the floor; the height is that of the one that is not.
        self._above = np.where(np.isnan(np.array(floor)[self._one]), self._one, self._other)

    def distances(self, frames: Frames) -> FloatArray:
        """(T, pairs) m that each pair's distance is not below."""
        centres = np.empty((3, len(self._joints), frames[0][1].shape[1]))
        for number, (turn, origin) in enumerate(frames):
            here = np.flatnonzero(self._joints == number)
            centres[:, here] = np.einsum("ijt,gj->igt", turn, self._centres[here]) + origin[:, None]
        between = centres[:, self._one] - centres[:, self._other]
        apart = np.sqrt((between * between).sum(axis=0))
        grounded = ~np.isnan(self._floor)
        apart[grounded] = centres[2, self._above[grounded]] - self._floor[grounded, None]
        return np.asarray((apart - self._touching).T)


def _geometry(arm: Arm, model: pin.Model) -> tuple[pin.GeometryModel, str, str]:
    """The geometries, and in words where they come from and what was lacking (empty: nothing)."""
    meshes = resolve_meshes(arm.urdf, arm.package_path)
    why = "the URDF has no geometry"
    for kind, words in ((pin.GeometryType.COLLISION, "collision"), (pin.GeometryType.VISUAL, "visual")):
        try:
            geometry = pin.buildGeomFromUrdfString(model, meshes.urdf, kind, None, [])
        except (ValueError, RuntimeError):
            why = meshes.advice or "its meshes cannot be read"
            continue
        covered = {g.parentJoint for g in geometry.geometryObjects}
        if len(covered - {0}) >= max(1, len(arm.joints) // 2):
            unfit = _replaced_by_hulls(geometry)
            if not unfit:
                return geometry, f"the URDF's {words} geometry", ""
            why = f"no convex hull of its mesh {unfit}"
    return _capsules(model), f"capsules from joint to joint ({why})", why


def _replaced_by_hulls(geometry: pin.GeometryModel) -> str:
    """Put convex hulls in the place of meshes; returns the file name of the first that has none, empty where all have.

    Coal builds none of a flat mesh, nor of one with a corner of more neighbours than it counts, as the tip of a cone.
    """
    for entry in geometry.geometryObjects:
        if isinstance(entry.geometry, coal.BVHModelBase):
            name = Path(entry.meshPath).name
            if _thickness(entry.geometry.vertices()) < _FLAT_M:
                return name
            try:
                entry.geometry.buildConvexHull(True, "Qt")
            except (ValueError, RuntimeError):
                return name
            entry.geometry = entry.geometry.convex
    return ""


def _thickness(points: FloatArray) -> float:
    """Extent of points (k, 3) across the plane nearest to them, m."""
    centred = points - points.mean(axis=0)
    return float(np.ptp(centred @ np.linalg.eigh(centred.T @ centred)[1][:, 0]))


def _capsules(model: pin.Model) -> pin.GeometryModel:
    """A capsule from every joint to each joint and frame it carries; a last link is a rod about its centre of mass."""
    ends: list[list[FloatArray]] = [[] for _ in range(model.njoints)]
    for joint in range(1, model.njoints):
        ends[model.parents[joint]].append(np.array(model.jointPlacements[joint].translation))
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY and frame.parentJoint > 0:
            ends[frame.parentJoint].append(np.array(frame.placement.translation))
    reach = sum(float(np.linalg.norm(model.jointPlacements[joint].translation)) for joint in range(1, model.njoints))
    radius = max(CAPSULE_SHARE * reach, 1e-3)
    for joint in range(1, model.njoints):
        if not _apart(ends[joint], radius / 2):
            ends[joint].append(2 * np.array(model.inertias[joint].lever))
    geometry = pin.GeometryModel()
    for joint, points in enumerate(ends):
        for number, end in enumerate(_apart(points, radius / 2)):
            length = float(np.linalg.norm(end))
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), end / length).matrix()
            shape = coal.Capsule(radius, length)
            name = f"{model.names[joint]}_{number}"
            geometry.addGeometryObject(pin.GeometryObject(name, joint, 0, pin.SE3(turn, end / 2), shape))
    return geometry


def _apart(points: Sequence[FloatArray], least: float) -> list[FloatArray]:
    """The points farther than `least` from the origin and from each other."""
    kept: list[FloatArray] = []
    for point in points:
        if all(float(np.linalg.norm(point - other)) > least for other in (np.zeros(3), *kept)):
            kept.append(point)
    return kept


def _link_name(model: pin.Model, entry: pin.GeometryObject) -> str:
    """The URDF link of a geometry; of a capsule, the joint that moves it."""
    if entry.parentFrame:
        return str(model.frames[entry.parentFrame].name)
    return str(model.names[entry.parentJoint]) if entry.parentJoint else "base"
