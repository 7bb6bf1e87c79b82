#!/usr/bin/env bash
# Gmsh 4.15.2 (PyPI gmsh), its OpenCASCADE kernel: getMass, getCenterOfMass and
# getMatrixOfInertia of half an ellipsoid, made as a half ball that is dilated.
#
# Expected: the surfaces are exact (rational B-splines), so the moments should be right
# to 1e-6 or better. We guessed so.
# Seen (2026-11-29): the half ball is right to rounding. Dilated, its volume is 1.0 %
# too large, the smallest moment of inertia 5.3 % too large and the middle one 3.5 % too
# small, and the centre of mass of this symmetric body lies 0.24 mm to one side. The
# surface itself is right: Gmsh's own mesh of it gives all of them to 0.2 %.
#
# For a stone: with a skew of 3 degrees, 60 rpm and a push of 6 rpm, the numbers of Gmsh
# make the first reversal 9.5 % late in one direction and 3.7 % in the other. CadQuery
# 2.8.0 has the same kernel and gives the same numbers, but for Volume(tol=1e-9), which
# is right. The centre of an ellipse's edge is wrong likewise (pythonocc-core, issue
# 747).
# It fails if that changes. It needs Python 3.11 or later, and writes to a folder that
# it removes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet gmsh==4.15.2 numpy==2.4.6
"$folder/venv/bin/python" - <<'PYTHON'
import gmsh
import numpy as np

A, B, C = 60.0, 15.0, 12.0  # mm, and the flat side is up, at z = 0
VOLUME = 2 * np.pi / 3 * A * B * C
CENTRE = np.array([0, 0, -3 / 8 * C])
MOMENTS = VOLUME / 5 * np.array([B**2 + C**2, A**2 + C**2, A**2 + B**2])
MOMENTS -= VOLUME * CENTRE[2] ** 2 * np.array([1, 1, 0])


def of_triangles(corners):
    """Return volume, centre and moments of a body that closed triangles bound."""
    first, second, third = corners.transpose(1, 0, 2)
    outwards = corners.mean(axis=1) - CENTRE
    volumes = np.einsum("ij,ij->i", first, np.cross(second, third)) / 6
    turned = np.einsum("ij,ij->i", np.cross(second - first, third - first), outwards)
    volumes *= np.sign(turned)
    total = corners.sum(axis=1)
    volume, centre = volumes.sum(), volumes @ total / 4 / volumes.sum()
    squares = volumes @ (total**2 + (corners**2).sum(axis=1)) / 20 - volume * centre**2
    return volume, centre, squares.sum() - squares


def show(name, volume, centre, moments):
    """Print relative errors, and return them."""
    errors = volume / VOLUME - 1, centre - CENTRE, np.asarray(moments) / MOMENTS - 1
    print(f"{name} | {errors[0]:+.6f} | {errors[1].round(4)} | {errors[2].round(5)}")
    return errors


gmsh.initialize()
gmsh.option.setNumber("General.Verbosity", 1)
shapes = gmsh.model.occ
solid = shapes.addSphere(0, 0, 0, 1, angle1=-np.pi / 2, angle2=0)
shapes.synchronize()
half_ball = shapes.getMass(3, solid) / (2 * np.pi / 3) - 1
shapes.dilate([(3, solid)], 0, 0, 0, A, B, C)
shapes.synchronize()
print("gmsh", gmsh.__version__, f"| error of the half ball's volume {half_ball:.1e}")
print("found by | volume, relative | centre, mm | moments of inertia, relative")
volume, centre, moments = show(
    "getMass ...",
    shapes.getMass(3, solid),
    np.array(shapes.getCenterOfMass(3, solid)),
    np.array(shapes.getMatrixOfInertia(3, solid))[::4],
)
gmsh.option.setNumber("Mesh.MeshSizeMax", 1.0)
gmsh.model.mesh.generate(2)
tags, places, _ = gmsh.model.mesh.getNodes()
place_of = dict(zip(tags, places.reshape(-1, 3)))
faces = gmsh.model.getBoundary([(3, solid)], oriented=False)
nodes = [gmsh.model.mesh.getElementsByType(2, face)[1] for _, face in faces]
corners = np.array([place_of[tag] for tag in np.concatenate(nodes)]).reshape(-1, 3, 3)
meshed = show("its mesh", *of_triangles(corners))
gmsh.finalize()
assert abs(half_ball) < 1e-12
assert 0.009 < volume < 0.011 and 0.2 < centre[0] < 0.3
assert 0.05 < moments[0] < 0.056 and -0.038 < moments[1] < -0.032
assert max(abs(meshed[0]), abs(meshed[1]).max(), abs(meshed[2]).max()) < 0.003
PYTHON
