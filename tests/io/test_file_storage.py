from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import array_shapes, arrays

from laci_stereo.io.file_storage import StorageError, parse_file_storage
from tests.io.support import fuzz, noise

FORMATS = ["yaml", "json", "xml"]
M = {"rows": 2.0, "cols": 1.0, "data": [1.0, 2.0], "t": {"a": "b"}}
FINITE = st.floats(allow_nan=False, allow_infinity=False)


def written(path: Path, matrix: np.ndarray, text: str) -> str:
    """Return what OpenCV itself writes: a matrix, a text, a sequence in one line, and one of maps."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("K1", matrix)
    storage.write("name", text)
    storage.write("count", 3)
    storage.startWriteStruct("size", cv2.FILE_NODE_SEQ | cv2.FILE_NODE_FLOW)
    storage.write("", 1280)
    storage.write("", 720)
    storage.endWriteStruct()
    storage.startWriteStruct("views", cv2.FILE_NODE_SEQ)
    for i in range(2):
        storage.startWriteStruct("", cv2.FILE_NODE_MAP)
        storage.write("view", i)
        storage.write("pose", np.eye(2) * i)
        storage.endWriteStruct()
    storage.endWriteStruct()
    storage.write("T", matrix)
    storage.release()
    return path.read_text()


@pytest.mark.parametrize("suffix", FORMATS)
def test_what_opencv_writes_comes_back_exactly(tmp_path: Path, suffix: str) -> None:
    @fuzz
    @given(
        arrays(np.float64, array_shapes(min_dims=2, max_dims=2), elements=FINITE),
        st.sampled_from(["fisheye", "a # b: c"]),
    )
    def check(matrix: np.ndarray, text: str) -> None:
        root = parse_file_storage(written(tmp_path / f"x.{suffix}", matrix, text))
        for name in ("K1", "T"):
            node = root[name]
            assert isinstance(node, dict)
            data = node["data"] if isinstance(node["data"], list) else [node["data"]]
            assert (node["rows"], node["cols"], node["dt"]) == (*matrix.shape, "d")
            assert data == matrix.ravel().tolist()
        assert (root["name"], root["count"], root["size"]) == (text, 3.0, [1280.0, 720.0])
        views = root["views"]
        assert isinstance(views, list)
        assert [view["view"] for view in views if isinstance(view, dict)] == [0.0, 1.0]

    check()


@pytest.mark.parametrize(
    ("text", "root"),
    [
        ("%YAML:1.0\n---\nK1: [1, 2.5, -3e2]\n", {"K1": [1.0, 2.5, -300.0]}),
        ("K1:\n  - [1, 2]\n  - [3, 4]\nn: 1\n", {"K1": [[1.0, 2.0], [3.0, 4.0]], "n": 1.0}),
        ("K1:\n- 1\n- 2\nn: 1\n", {"K1": [1.0, 2.0], "n": 1.0}),
        ("a:\n  b:\n    c: 1 # one\n  d: 'x # y'\n", {"a": {"b": {"c": 1.0}, "d": "x # y"}}),
        (
            "cams:\n  - name: left\n    f: 3\n  - name: right\n",
            {"cams": [{"name": "left", "f": 3.0}, {"name": "right"}]},
        ),
        ("K1: [ 1,\n   2 ]\r\nempty:\nn: 1", {"K1": [1.0, 2.0], "empty": "", "n": 1.0}),
        ("m: {rows: 2, cols: 1,\n  data: [1, 2], t: {a: b}}\nn: 1", {"m": M, "n": 1.0}),
        ("m: [ .Nan, -.Inf ]", None),
        ('{"K1": [[1, 2], [3, 4]], "n": null}', {"K1": [[1.0, 2.0], [3.0, 4.0]], "n": "None"}),
        ("<?xml version='1.0'?><opencv_storage><a>1 2.</a><b>\"x\"</b></opencv_storage>", {"a": [1.0, 2.0], "b": "x"}),
    ],
)
def test_the_three_languages(text: str, root: object) -> None:
    found = parse_file_storage(text)
    if root is None:
        assert np.isnan(found["m"][0])
        assert found["m"][1] == -np.inf
    else:
        assert found == root


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("hello", "holds no names"),
        ("[1, 2]", "holds no names"),
        ("a: [1, 2", "line 1: a bracket is never closed"),
        ("a: 1\nb: [1]]\n", "line 2: the brackets do not match"),
        ("a: 1\n    b: 2\n", "line 2: the indent fits to no line above"),
        ("a: " + "[" * 1000 + "]" * 1000, "nests deeper than 20"),
        ("".join(f"{' ' * i}a:\n" for i in range(100)), "nests deeper than 20"),
        ('{"a": ' + "[" * 50 + "]" * 50 + "}", "nests deeper than 20"),
        ('{"a": ' + "[" * 100_000, "recursion|depth|nest"),
        ('{"a": 1', "well-formed JSON"),
        ("<a><b></a>", "well-formed XML"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>', "document type .* is refused"),
    ],
)
def test_what_is_no_file_storage(text: str, message: str) -> None:
    with pytest.raises(StorageError, match=message):
        parse_file_storage(text)


@fuzz
@given(
    noise("K1", ":", " ", "\n", "- ", "[", "]", "{", "}", '"', "'", "#", "!!opencv-matrix", "<", ">", "</a>", "1.", "&")
)
def test_any_text_is_parsed_or_refused(content: bytes) -> None:
    try:
        root = parse_file_storage(content.decode("utf-8", "replace"))
    except StorageError:
        return
    assert isinstance(root, dict)
