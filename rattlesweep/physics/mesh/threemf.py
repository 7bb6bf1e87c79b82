"""3MF files, with the parts that slicers add to a stone and do not print.

A 3MF file is an archive.  Its root part lists objects and the items to be built.  An
object is a mesh, or has components: other objects, each with a transform, which may be
in other parts of the archive (the production extension).  Numbers of objects are unique
within one part only.

Slicers keep beside it which parts of an object are not plastic: modifiers, which change
how others are printed, supports, and negative parts, which are cut out.  Libraries for
meshes know none of these, take parts of an archive for one another, or keep places in
single precision.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import BinaryIO, NamedTuple
from xml.etree.ElementTree import Element, ParseError, TreeBuilder, XMLParser

import numpy as np

from rattlesweep.arrays import Floats, Integers
from rattlesweep.physics.mesh.archive import Archive
from rattlesweep.physics.mesh.shells import without
from rattlesweep.physics.mesh.solid import Solid
from rattlesweep.words.errors import one_line
from rattlesweep.words.units import quantity

MOST_DEPTH = 32  # of components in components
MOST_COMPONENTS = 10_000
MOST_FACETS = 20_000_000
# Extensions that leave the solid as its meshes say.
_HARMLESS = ("production", "material", "trianglesets", "slice")
_ROOT = "3D/3dmodel.model"
_RELATIONS = "_rels/.rels"
_PLASTIC = "plastic"
_CUT = "cut"


class Component(NamedTuple):
    """Another object within an object, or an item to be built."""

    path: str  # of its part; empty: the part that names it
    number: str
    transform: Floats  # shape (4, 3): rows of a matrix that multiplies from the right
    is_printed: bool


class Use(NamedTuple):
    """What a slicer does with a part of an object."""

    name: str
    kind: str  # "plastic", "cut", or what it is instead
    number: str | None  # of the component
    triangles: tuple[int, int] | None  # first and last of the mesh


class Piece(NamedTuple):
    """A mesh in its place, and what it is for."""

    use: Use
    vertices: Floats
    faces: Integers


@dataclass
class Resource:
    """An object: a mesh or components."""

    name: str
    kind: str  # of its type
    places: list[tuple[float, float, float]] = field(default_factory=list)
    corners: list[tuple[int, int, int]] = field(default_factory=list)
    components: list[Component] = field(default_factory=list)


class _NoEntities:
    """A target of an XML parser that refuses what could expand."""

    def doctype(self, name: str, public: str, system: str) -> None:
        raise ValueError("it declares XML entities, which no 3MF file may")


class _Notes(_NoEntities, TreeBuilder):
    """The tree of a small XML file."""

    root: Element

    def close(self) -> Element:
        self.root = super().close()
        return self.root


class _Model(_NoEntities):
    """One model part of the archive."""

    def __init__(self) -> None:
        self.unit = "millimeter"
        self.resources: dict[str, Resource] = {}
        self.items: list[Component] = []
        self._core: str | None = None
        self._spaces: dict[str, str] = {}
        self._current = Resource("", "model")
        self._metadata = ""  # name of the one that is open
        self._text = ""

    def start_ns(self, prefix: str, uri: str) -> None:
        self._spaces.setdefault(prefix, uri)

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        space, _, name = tag.rpartition("}")
        if self._core is None:
            self._begin(space, name, attributes)
        elif space != self._core:
            return
        elif name == "vertex":
            x, y, z = attributes["x"], attributes["y"], attributes["z"]
            self._current.places.append((float(x), float(y), float(z)))
        elif name == "triangle":
            a, b, c = attributes["v1"], attributes["v2"], attributes["v3"]
            self._current.corners.append((int(a), int(b), int(c)))
        elif name == "object":
            number = attributes["id"]
            self._current = Resource(
                attributes.get("name", ""), attributes.get("type", "model")
            )
            self.resources[number] = self._current
        elif name == "component":
            self._current.components.append(_component(attributes))
        elif name == "item":
            self.items.append(_component(attributes))
        elif name == "metadata":
            self._metadata = attributes.get("name", "")
            self._text = ""

    def _begin(self, space: str, name: str, attributes: dict[str, str]) -> None:
        if name != "model":
            raise ValueError(f"its root is {one_line(name)!r} instead of 'model'")
        self._core = space
        self.unit = attributes.get("unit", "millimeter")
        for prefix in attributes.get("requiredextensions", "").split():
            uri = self._spaces.get(prefix, prefix)
            if not any(word in uri.casefold() for word in _HARMLESS):
                raise ValueError(
                    f"it needs the extension {one_line(uri)} of 3MF, which is not "
                    "read; export one STL"
                )

    def data(self, text: str) -> None:
        if self._metadata:
            self._text += text

    def end(self, tag: str) -> None:
        if not self._metadata or not tag.endswith("}metadata"):
            return
        word = self._metadata.rpartition(":")[2]
        # Cura keeps with the object what its mesh is for.
        if self._text.strip().casefold() == "true" and word in _CURA:
            self._current.kind = _CURA[word]
        self._metadata = ""


_CURA = {
    "infill_mesh": "modifier",
    "cutting_mesh": "modifier",
    "support_mesh": "support",
    "anti_overhang_mesh": "support blocker",
}


def read_3mf(file: BinaryIO, scale: float, unit: str) -> Solid:
    """Return the solid of a file; `scale` is the length of its `unit` in m."""
    return _Reader(Archive(file)).solid(scale, unit)


class _Reader:
    """The parts of an archive, each read once."""

    def __init__(self, archive: Archive) -> None:
        self.archive = archive
        self.models: dict[str, _Model] = {}
        self.root = self._name_of_root()
        self.uses = self._uses()
        self.n_components = 0
        self.n_triangles = 0

    def solid(self, scale: float, unit: str) -> Solid:
        """Return the solid of all that is printed, in m."""
        model = self._model(self.root)
        own = quantity(f"1 {model.unit}", "length")
        if abs(own / scale - 1) > 1e-6:
            raise ValueError(
                f"the file says that its unit is {one_line(model.unit)}, and the unit "
                f"given is {unit}; give {one_line(model.unit)}"
            )
        remarks = []
        left_out: dict[str, str] = {}
        kept: list[Piece] = []
        for item in model.items:
            pieces = list(self._pieces(item, self.root, 0))
            if not item.is_printed:
                left_out[self._name(item)] = "not printable"
                continue
            for piece in pieces:
                if piece.use.kind not in (_PLASTIC, _CUT):
                    left_out[piece.use.name] = piece.use.kind
            kept += _plastic(pieces, scale)
            for piece in pieces:
                if piece.use.kind == _CUT:
                    remarks.append(f"the negative part {piece.use.name!r} is cut out")
        if not kept:
            raise ValueError(self._why_nothing(left_out))
        if left_out:
            listed = ", ".join(f"{name!r} ({why})" for name, why in left_out.items())
            remark = f"left out, as no plastic of the stone: {one_line(listed, 300)}"
            if "modifier" in left_out.values():
                remark += (
                    "; weight that a modifier adds by its infill must be given as "
                    "points"
                )
            remarks.append(remark)
        found = _joined(kept, 1.0)
        return Solid(found.vertices, found.faces, tuple(remarks))

    def _why_nothing(self, left_out: dict[str, str]) -> str:
        if left_out:
            listed = ", ".join(f"{name!r} ({why})" for name, why in left_out.items())
            return (
                f"nothing of the file is plastic of a stone: {one_line(listed, 300)}; "
                "export the stone as one STL"
            )
        if any(name.casefold().endswith(".gcode") for name in self.archive.names):
            return (
                "the file is a sliced plate: it has G-code for a printer and no mesh; "
                "export the model itself, as 3MF or STL"
            )
        return "the file has no item to be built; put the stone on the plate"

    def _name_of_root(self) -> str:
        if _RELATIONS in self.archive:
            for relation in self._notes(_RELATIONS):
                if relation.get("Type", "").endswith("/3dmodel"):
                    return relation.get("Target", _ROOT)
        return _ROOT

    def _model(self, path: str) -> _Model:
        if path not in self.models:
            self.models[path] = _Model()
            self._parse(path, self.models[path])
        return self.models[path]

    def _notes(self, path: str) -> Element:
        """Return the root of a small XML file."""
        notes = _Notes()
        self._parse(path, notes)
        return notes.root

    def _parse(self, path: str, target: _Model | _Notes) -> None:
        """Tell a target all of an XML file."""
        if path not in self.archive:
            raise ValueError(f"its part {one_line(path)} is missing; export it again")
        parser = XMLParser(target=target)
        try:
            for piece in self.archive.pieces(path):
                parser.feed(piece)
            # It also closes the target.
            parser.close()
        except (ParseError, KeyError, ValueError) as error:
            raise ValueError(
                f"cannot be read as 3MF: {one_line(path)}: {one_line(str(error), 200)}"
            ) from None

    def _uses(self) -> dict[str, list[Use]]:
        """Return what slicers note about the parts of each object of the root."""
        uses: dict[str, list[Use]] = {}
        for name in self.archive.names:
            if not name.casefold().startswith("metadata/"):
                continue
            if not name.casefold().endswith(_NOTES):
                continue
            for element in self._notes(name):
                if element.tag == "object":
                    found = [_use(each) for each in element if each.tag in _PARTS]
                    uses.setdefault(element.get("id", ""), []).extend(found)
        return uses

    def _resource(self, path: str, number: str) -> Resource:
        resources = self._model(path).resources
        if number not in resources:
            raise ValueError(
                f"cannot be read as 3MF: {one_line(path)} has no object "
                f"{one_line(number)}"
            )
        return resources[number]

    def _name(self, item: Component) -> str:
        resource = self._resource(item.path or self.root, item.number)
        return resource.name or f"object {item.number}"

    def _pieces(self, component: Component, path: str, depth: int) -> Iterator[Piece]:
        """Yield the meshes of a component, in the frame of what names it."""
        self.n_components += 1
        if depth > MOST_DEPTH or self.n_components > MOST_COMPONENTS:
            raise ValueError(
                f"its components are more than {MOST_DEPTH} deep, or more than "
                f"{MOST_COMPONENTS:,}; export one STL"
            )
        path = component.path or path
        resource = self._resource(path, component.number)
        # Notes are about objects of the root part.
        uses = []
        if path == self.root:
            uses = self.uses.get(component.number, [])
        if resource.components:
            pieces = self._pieces_of_components(resource, uses, path, depth)
        else:
            pieces = self._pieces_of_mesh(resource, uses, component.number)
        turn = component.transform
        is_mirrored = np.linalg.det(turn[:3]) < 0
        for use, vertices, faces in pieces:
            if resource.kind != "model" and use.kind == _PLASTIC:
                use = use._replace(kind=resource.kind)
            if is_mirrored:
                faces = faces[:, ::-1]
            yield Piece(use, vertices @ turn[:3] + turn[3], faces)

    def _pieces_of_components(
        self, resource: Resource, uses: list[Use], path: str, depth: int
    ) -> Iterator[Piece]:
        """Yield the meshes of an object that has components."""
        left = list(uses)
        for component in resource.components:
            # Two components may have one number, from two parts of the archive: notes
            # follow in the order of components.
            noted = [use for use in left if use.number == component.number]
            if noted:
                left.remove(noted[0])
            for piece in self._pieces(component, path, depth + 1):
                if noted and piece.use.kind == _PLASTIC:
                    name = noted[0].name or piece.use.name
                    use = piece.use._replace(name=name, kind=noted[0].kind)
                    piece = piece._replace(use=use)
                yield piece

    def _pieces_of_mesh(
        self, resource: Resource, uses: list[Use], number: str
    ) -> Iterator[Piece]:
        """Yield the mesh of an object, or the parts of it that notes tell."""
        self.n_triangles += len(resource.corners)
        if self.n_triangles > MOST_FACETS:
            raise ValueError(
                f"it has more than {MOST_FACETS:,} triangles; export a coarser mesh"
            )
        vertices = np.array(resource.places, float).reshape(-1, 3)
        faces = np.array(resource.corners, np.int64).reshape(-1, 3)
        if len(faces) and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise ValueError(
                f"cannot be read as 3MF: object {one_line(number)} has a triangle "
                "without a vertex"
            )
        name = resource.name or f"object {number}"
        is_left = np.ones(len(faces), dtype=bool)
        for use in uses:
            chosen = is_left.copy()
            if use.triangles is not None:
                first, last = use.triangles
                chosen[:first] = False
                chosen[last + 1 :] = False
            is_left &= ~chosen
            if chosen.any():
                yield Piece(
                    use._replace(name=use.name or name), vertices, faces[chosen]
                )
        if is_left.any():
            yield Piece(Use(name, _PLASTIC, None, None), vertices, faces[is_left])


def _plastic(pieces: list[Piece], scale: float) -> Iterator[Piece]:
    """Yield the plastic of an item in m, less its negative parts."""
    plastic = [piece for piece in pieces if piece.use.kind == _PLASTIC]
    cuts = [piece for piece in pieces if piece.use.kind == _CUT]
    if plastic and cuts:
        whole = without(_joined(plastic, scale), _joined(cuts, scale))
        yield Piece(plastic[0].use, whole.vertices, whole.faces)
        return
    for use, vertices, faces in plastic:
        yield Piece(use, vertices * scale, faces)


def _joined(pieces: list[Piece], scale: float) -> Solid:
    """Return the solid of some meshes, whose unit is `scale` in m."""
    faces = []
    count = 0
    for piece in pieces:
        faces.append(piece.faces + count)
        count += len(piece.vertices)
    vertices = np.vstack([piece.vertices for piece in pieces])
    return Solid.of(vertices * scale, np.vstack(faces))


def _component(attributes: dict[str, str]) -> Component:
    transform = np.vstack([np.eye(3), np.zeros(3)])
    if "transform" in attributes:
        numbers = [float(word) for word in attributes["transform"].split()]
        if len(numbers) != 12:
            raise ValueError(f"a transform has {len(numbers)} numbers, and 12 are due")
        transform = np.array(numbers).reshape(4, 3)
    path = ""
    is_printed = True
    for key, value in attributes.items():
        name = key.rpartition("}")[2]
        if name == "path":
            path = value
        elif name == "printable":
            is_printed = value.strip().casefold() not in ("0", "false")
    return Component(path, attributes["objectid"], transform, is_printed)


# Slic3r and its heirs, Bambu Studio and Orca.
_NOTES = ("_model.config", "model_settings.config")
_PARTS = ("volume", "part")


def _use(element: Element) -> Use:
    """Return what a slicer notes about a part of an object."""
    kept = {}
    for each in element.iter("metadata"):
        kept[each.get("key", "")] = each.get("value", "")
    word = element.get("subtype") or kept.get("volume_type")
    if word is None:
        word = "modifier" if kept.get("modifier") == "1" else "model_part"
    triangles = None
    first, last = element.get("firstid"), element.get("lastid")
    if first is not None and last is not None:
        triangles = int(first), int(last)
    name = kept.get("name", "")
    return Use(name, _kind(word, name), element.get("id"), triangles)


def _kind(word: str, name: str) -> str:
    """Return what the kind of a part means, in the words of either slicer."""
    plain = word.casefold().replace("_", "")
    if plain in ("modelpart", "normalpart"):
        return _PLASTIC
    if plain.startswith("negative"):
        return _CUT
    if "modifier" in plain:
        return "modifier"
    if plain.startswith("support"):
        return "support blocker" if "blocker" in plain else "support"
    raise ValueError(
        f"its part {one_line(name)!r} is of the kind {one_line(word)!r}, which is not "
        "known; export one STL of the stone"
    )
