"""Stereo calibrations in OpenCV's FileStorage (YAML, JSON, XML), in one file or two."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from laci_stereo.core.errors import RigError
from laci_stereo.io.file_storage import Node
from laci_stereo.io.rig.document import Document, Entry, numbers, plain
from laci_stereo.io.rig.stereo_rig import ForImages, Lens, Model, Size, StereoRig, rectified_pair
from laci_stereo.io.text_file import listed, quoted

COEFFICIENTS: Mapping[Model, tuple[int, ...]] = {"pinhole": (4, 5, 8, 12, 14), "fisheye": (4,)}
"""Numbers of distortion coefficients that OpenCV's models can have."""

MATRIX = ("K", "M", "cameraMatrix", "intrinsics", "intrinsicMatrix", "mtx")
DISTORTION = ("D", "distCoeffs", "distCoeff", "distortion", "distortionCoefficients", "distortionCoeffs", "dist")
ROTATION = Entry("rotation between the cameras", ("R", "rotation", "rotationMatrix", "stereoR", "rotationOfCamera2"))
TRANSLATION = Entry(
    "translation between the cameras",
    ("T", "translation", "translationVector", "trans", "stereoT", "translationOfCamera2"),
)
_SIDES: tuple[Literal["left", "right"], ...] = ("left", "right")
_MATRICES = {side: Entry.of_camera("camera matrix", MATRIX, side) for side in _SIDES}
_DISTORTIONS = {side: Entry.of_camera("distortion", DISTORTION, side) for side in _SIDES}
_ENTRIES = (*_MATRICES.values(), *_DISTORTIONS.values(), ROTATION, TRANSLATION)
_NAMES = frozenset(plain(name) for entry in _ENTRIES for name in entry.names)
_LENSES = tuple({_MATRICES[side].what, _DISTORTIONS[side].what} for side in _SIDES)
_PROJECTION = ("P", "projectionMatrix", "projection")
_MODEL_NAMES = ("model", "distortionmodel", "cameramodel")
_FISHEYE_FLAGS = ("fisheye", "fisheyemodel", "isfisheye", "usefisheye")
_FALSE = ("", "0", "false", "no", "none")
MODELS: Mapping[str, Model] = {
    **dict.fromkeys(("fisheye", "equidistant", "kannalabrandt", "kannalabrandt4", "kb4"), "fisheye"),
    **dict.fromkeys(("pinhole", "plumbbob", "radtan", "rationalpolynomial", "rational", "thinprism"), "pinhole"),
    **dict.fromkeys(("tilted", "standard", "opencv", "brown", "brownconrady", "perspective"), "pinhole"),
}


def read_opencv(documents: Sequence[Document], images: ForImages) -> StereoRig:
    """Read files that no reader of another format accepts.

    Raises
    ------
    RigError
    """
    document, notes = _merged([_flattened(document) for document in documents])
    model = model_of(document)
    size = document.size()
    if size is None:
        size, notes = images.size, (*notes, "the file tells no image size; taken from the images")
    if size is None:
        raise RigError(
            f"{document.name} lacks the image size; needed are image_width and image_height, it holds "
            f"{listed(list(document.root))}"
        )
    left, right = (_lens(document, side, size, model) for side in _SIDES)
    if model == "pinhole" and {len(left.distortion), len(right.distortion)} == {4} and not _names_model(document):
        notes = (*notes, "four distortion coefficients and no model named; taken as k1, k2, p1, p2, not as a fisheye's")
    rotation = document.array(ROTATION, (3, 3), (3,))
    if rotation.shape == (3,):
        rotation = Rotation.from_rotvec(rotation).as_matrix()
        notes = (*notes, "the rotation is three numbers; taken as a rotation vector, rad")
    rig = StereoRig(left, right, rotation, document.array(TRANSLATION, (3,)), notes)
    return replace(rig, rectified=_rectified(document, size))


def model_of(document: Document) -> Model:
    """Return the lens model that a file names; pinhole if it names none.

    Raises
    ------
    RigError
        If it names an unknown model.
    """
    models: list[Model] = []
    for name, node in document.root.items():
        if plain(name) in _MODEL_NAMES:
            model = MODELS.get(plain(node)) if isinstance(node, str) else None
            if model is None:
                raise RigError(f"{document.name}: {name} is {quoted(str(node))}; needed is pinhole or fisheye")
            models.append(model)
        elif plain(name) in _FISHEYE_FLAGS and node != 0.0 and plain(str(node)) not in _FALSE:
            models.append("fisheye")
    return "fisheye" if "fisheye" in models else "pinhole"


def _names_model(document: Document) -> bool:
    return any(plain(name) in (*_MODEL_NAMES, *_FISHEYE_FLAGS) for name in document.root)


def _lens(document: Document, side: Literal["left", "right"], size: Size, model: Model) -> Lens:
    K = document.array(_MATRICES[side], (3, 3))
    shapes = tuple((count,) for count in COEFFICIENTS[model])
    distortion = document.array(Entry.of_camera(f"{model} distortion", DISTORTION, side), *shapes)
    return Lens(K, distortion, size, model)


def _rectified(document: Document, size: Size) -> StereoRig | None:
    """Return the rig of the rectified images, if the file has their projection matrices."""
    entries = [Entry.of_camera("projection", _PROJECTION, side) for side in _SIDES]
    if any(document.find(entry) is None for entry in entries):
        return None
    left_P, right_P = (document.array(entry, (3, 4)) for entry in entries)
    return rectified_pair(left_P, right_P, size, ("rectified images as the projections P1 and P2 in the file say",))


def _flattened(document: Document) -> Document:
    """Return a document in which the cameras' sections are merged into one level: ``left: {K: ...}`` as ``left_K``."""
    root: dict[str, Node] = {}
    for name, node in document.root.items():
        if isinstance(node, dict) and numbers(node) is None and not {"data", "rows"} & node.keys():
            prefix = f"{name}_" if plain(name) in ("left", "right") else ""
            root |= {f"{prefix}{inner}": value for inner, value in node.items()}
        else:
            root[name] = node
    return Document(document.name, root)


def _merged(documents: Sequence[Document]) -> tuple[Document, tuple[str, ...]]:
    """Merge two files; an entry of both is taken from the file that has the translation between the cameras.

    An exception: a camera's matrix and distortion, which were estimated together, are taken from the other file if only
    that has both.
    """
    if len(documents) == 1:
        return documents[0], ()
    inner, outer = sorted(documents, key=lambda document: document.find(TRANSLATION) is not None)
    inner_names, outer_names = _told(inner), _told(outer)
    halves = {
        what for lens in _LENSES if lens <= inner_names.keys() and not lens <= outer_names.keys() for what in lens
    }
    root = {name: inner.root[name] for what, name in inner_names.items() if what not in outer_names or what in halves}
    root |= {name: outer.root[name] for what, name in outer_names.items() if what not in halves}
    notes: list[str] = []
    for whats, source in (
        ([what for what in outer_names if what in halves], f"{inner.name}, which has the whole lens"),
        ([what for what in outer_names if what not in halves], outer.name),
    ):
        pairs = [(inner_names[what], outer_names[what]) for what in whats if what in inner_names]
        names = [name for pair in pairs if not _same(inner.root[pair[0]], outer.root[pair[1]]) for name in pair]
        if names:
            notes.append(f"{listed([*dict.fromkeys(names)])}: in both files, and not the same; taken from {source}")
    return Document(" + ".join(document.name for document in documents), root), tuple(notes)


def _told(document: Document) -> dict[str, str]:
    """Return the file's name for each quantity (of several names the preferred one), by the quantity's description."""
    known = {entry.what: found for entry in _ENTRIES if (found := document.key(entry)) is not None}
    return known | {plain(name): name for name in document.root if plain(name) not in _NAMES}


def _same(node: Node, other: Node) -> bool:
    first, second = numbers(node), numbers(other)
    if first is None or second is None:
        return node == other
    return first.shape == second.shape and np.array_equal(first, second)
