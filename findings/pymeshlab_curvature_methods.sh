#!/usr/bin/env bash
# PyMeshLab 2025.7.post1: compute_curvature_principal_directions_per_vertex, colours
# "Mean Curvature" and "Gaussian Curvature" as vertex_scalar_array has them, at the
# lowest point of an ellipsoid of 60 x 15 x 12 mm, in 5,120 to 81,920 triangles.
#
# Expected: its methods differ by some per cent, and less with finer meshes.
# Seen (2026-11-29): "Quadric Fitting" does, and is right to 0.6, 0.1 and 0.04 %.
# "Normal Cycles" gives 9.3, 2.3 and 0.58 times the mean curvature: it is the sum around
# a vertex, not divided by an area, and tends to 0. "Taubin approximation" converges to
# 0.286 times it and to a Gaussian curvature below zero, a saddle at the bottom of an
# ellipsoid. "Principal Component Analysis" tends to minus infinity.
#
# For a stone: a saddle does not rest, and a mean curvature within a factor of two of
# the right one may be so by the size of its triangles. Only the directions can be used.
# Issue 428 of cnr-isti-vclab/PyMeshLab, open, adds that smallest and largest are
# exchanged.
# It fails if that changes. It needs Python 3.11 or later, and writes to a folder that
# it removes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet pymeshlab==2025.7.post1 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
from importlib.metadata import version

import numpy as np
import pymeshlab

A, B, C = 60.0, 15.0, 12.0
ALONG, ACROSS = C / A**2, C / B**2  # curvatures at the lowest point, 1/mm
MEAN, GAUSSIAN = (ALONG + ACROSS) / 2, ALONG * ACROSS


def ellipsoid(subdivisions):
    """Return vertices and triangles with a vertex close to the lowest point."""
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.create_sphere(radius=1, subdiv=subdivisions)
    ball = meshes.current_mesh()
    points = ball.vertex_matrix()
    points /= np.linalg.norm(points, axis=1)[:, None]
    return points * [A, B, C], ball.face_matrix()


def at_bottom(points, faces, method, quantity):
    """Return what a method finds at the lowest vertex."""
    meshes = pymeshlab.MeshSet(verbose=False)
    meshes.add_mesh(pymeshlab.Mesh(points, faces))
    meshes.compute_curvature_principal_directions_per_vertex(
        method=method, curvcolormethod=quantity, autoclean=False
    )
    return meshes.current_mesh().vertex_scalar_array()[np.argmin(points[:, 2])]


print("pymeshlab", version("pymeshlab"))
print("method | triangles | mean curvature over the exact one | the same of Gaussian")
found = {}
for method in (
    "Quadric Fitting",
    "Normal Cycles",
    "Taubin approximation",
    "Principal Component Analysis",
):
    for subdivisions in (4, 5, 6):
        points, faces = ellipsoid(subdivisions)
        mean = at_bottom(points, faces, method, "Mean Curvature") / MEAN
        gaussian = at_bottom(points, faces, method, "Gaussian Curvature") / GAUSSIAN
        found.setdefault(method, []).append((mean, gaussian))
        print(f"{method} | {len(faces)} | {mean:.4f} | {gaussian:.4f}")
means = {method: np.array(pairs)[:, 0] for method, pairs in found.items()}
assert max(abs(means["Quadric Fitting"] - 1)) < 0.01
assert abs(np.array(found["Quadric Fitting"])[-1] - 1).max() < 0.005
assert np.allclose(means["Normal Cycles"], [9.28, 2.32, 0.58], rtol=0.02)
assert np.allclose(means["Taubin approximation"], 0.286, rtol=0.02)
assert max(gaussian for _, gaussian in found["Taubin approximation"]) < -0.4
assert max(means["Principal Component Analysis"]) < -5000
PYTHON
