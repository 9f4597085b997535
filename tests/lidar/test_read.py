from __future__ import annotations

import struct
import sys
import tracemalloc
from pathlib import Path

import laspy
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from laci_lidar import lzf
from laci_lidar.errors import ScanError
from laci_lidar.read import SUFFIXES, read_scan
from pypcd4 import Encoding
from pyproj import CRS

from tests.io.support import fuzz, mutations, noise, read_or_refused
from tests.lidar.support import (
    EPOCH_NS,
    FILE_FORMATS,
    RESOLUTION_M,
    records_of,
    scene,
    write_bin,
    write_las,
    write_npy,
    write_npz,
    write_pcd,
    write_structured_npy,
    xyz_of,
)

SCENE = scene()
TIMED = ["pcd ascii", "pcd binary", "pcd compressed", "ply big-endian", "laz", "npy structured", "npz"]
FLOATS = [form for form in FILE_FORMATS if form not in ("las", "laz")]
PCD_HEADER = (
    "# .PCD v0.7\nVERSION 0.7\nFIELDS {fields}\nSIZE {sizes}\nTYPE {types}\nCOUNT {counts}\nWIDTH {points}\nHEIGHT 1\n"
    "VIEWPOINT 0 0 0 1 0 0 0\nPOINTS {points}\nDATA {data}\n"
)


def header(fields="x y z", sizes="4 4 4", types="F F F", counts="1 1 1", points=2, data="binary") -> bytes:
    return PCD_HEADER.format(**locals()).encode()


def refusal(path: Path) -> str:
    with pytest.raises(ScanError) as refused:
        read_scan(path)
    assert str(path) in str(refused.value)
    assert len(str(refused.value).splitlines()) == 1
    return str(refused.value)


@pytest.mark.parametrize("form", FILE_FORMATS)
def test_every_format_gives_the_same_points(form: str, tmp_path: Path):
    suffix, write = FILE_FORMATS[form]
    scan = read_scan(write(tmp_path / f"scan{suffix}", SCENE))
    np.testing.assert_allclose(scan.points, xyz_of(SCENE), rtol=0.0, atol=RESOLUTION_M.get(form, 0.0))
    assert scan.points.dtype == np.float64
    if form not in ("ply ascii", "ply binary"):
        assert scan.intensity is not None
        np.testing.assert_array_equal(scan.intensity, SCENE["intensity"])


@pytest.mark.parametrize("form", TIMED)
def test_formats_with_fields_keep_each_points_time(form: str, tmp_path: Path):
    suffix, write = FILE_FORMATS[form]
    scan = read_scan(write(tmp_path / f"scan{suffix}", SCENE))
    assert scan.offset_s is not None
    np.testing.assert_allclose(scan.offset_s, SCENE["t"] / 1e9, atol=1e-9)


@pytest.mark.parametrize("encoding", [Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_fields_may_come_in_any_order_and_type(encoding: Encoding, dtype: type, tmp_path: Path):
    columns = {
        "ring": np.arange(300, dtype=np.uint16),
        "z": SCENE["z"].astype(dtype),
        "flag": np.ones(300, dtype=np.int8),
        "x": SCENE["x"].astype(dtype),
        "Intensity": np.arange(300, dtype=np.uint8),
        "y": SCENE["y"].astype(dtype),
    }
    scan = read_scan(write_pcd(tmp_path / "scan.pcd", columns, encoding))
    np.testing.assert_allclose(scan.points, xyz_of(SCENE), atol=1e-6)
    assert scan.intensity is not None
    np.testing.assert_array_equal(scan.intensity, columns["Intensity"])
    assert scan.offset_s is None


def test_fields_of_several_values_and_padding_are_passed_over(tmp_path: Path):
    layout = np.dtype([("a", "u1", 3), ("x", "<f4"), ("f", "<f4", 33), ("y", "<f4"), ("b", "u1"), ("z", "<f8")])
    records = np.zeros(300, layout)
    for axis in "xyz":
        records[axis] = SCENE[axis]
    head = header("_ x fpfh y _ z", "1 4 4 4 1 8", "U F F F U F", "3 1 33 1 1 1", 300)
    (tmp_path / "scan.pcd").write_bytes(head + records.tobytes())
    np.testing.assert_array_equal(read_scan(tmp_path / "scan.pcd").points, xyz_of(SCENE))
    compressed = b"".join(np.ascontiguousarray(records[name]).tobytes() for name in layout.names)
    literal = b"".join(
        bytes([len(part) - 1]) + part for part in (compressed[i : i + 32] for i in range(0, len(compressed), 32))
    )
    head = header("_ x fpfh y _ z", "1 4 4 4 1 8", "U F F F U F", "3 1 33 1 1 1", 300, "binary_compressed")
    (tmp_path / "scan.pcd").write_bytes(head + struct.pack("<II", len(literal), len(compressed)) + literal)
    np.testing.assert_array_equal(read_scan(tmp_path / "scan.pcd").points, xyz_of(SCENE))


def test_long_integers_keep_their_digits_in_text(tmp_path: Path):
    times = EPOCH_NS + np.array([7, 50_000_011, 99_999_993])
    rows = "".join(f"{i + 1} 2 3 {time}\n" for i, time in enumerate(times))
    (tmp_path / "scan.pcd").write_bytes(
        header("x y z timestamp", "4 4 4 8", "F F F U", "1 1 1 1", 3, "ascii") + rows.encode()
    )
    scan = read_scan(tmp_path / "scan.pcd", EPOCH_NS)
    assert scan.offset_s is not None
    np.testing.assert_allclose(scan.offset_s * 1e9, times - EPOCH_NS, atol=1e-6)


@pytest.mark.parametrize("encoding", [Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED])
def test_beams_without_return_are_left_out(encoding: Encoding, tmp_path: Path):
    columns = {name: column.copy() for name, column in SCENE.items()}
    columns["x"][3] = columns["y"][5] = np.nan
    columns["z"][8] = np.inf
    columns["x"][9] = 1e10
    for axis in "xyz":
        columns[axis][20:25] = 0.0
        columns[axis][30] = 0.001
    scan = read_scan(write_pcd(tmp_path / "scan.pcd", columns, encoding))
    keep = np.setdiff1d(np.arange(300), [3, 5, 8, 9, 20, 21, 22, 23, 24, 30])
    np.testing.assert_allclose(scan.points, xyz_of(SCENE)[keep], atol=1e-6)
    assert scan.intensity is not None
    np.testing.assert_array_equal(scan.intensity, SCENE["intensity"][keep])
    assert scan.offset_s is not None
    assert len(scan.offset_s) == len(scan)


def test_the_content_tells_the_format_of_files_with_other_names(tmp_path: Path):
    for form, (suffix, write) in FILE_FORMATS.items():
        if form != "kitti":
            write(tmp_path / f"scan{suffix}", SCENE).rename(tmp_path / "scan.dat")
            assert len(read_scan(tmp_path / "scan.dat")) == 300


def test_ply_with_other_elements_and_comments(tmp_path: Path):
    text = (
        "ply\r\nformat ascii 1.0\r\ncomment by hand\r\nelement camera 1\r\nproperty float f\r\nelement vertex 2\r\n"
        "property uchar red\r\nproperty float x\r\nproperty float y\r\nproperty double z\r\nelement face 1\r\n"
        "property list uchar int vertex_index\r\nend_header\r\n35.0\r\n9 1 2 3\r\n9 4 5 6\r\n3 0 1 0\r\n"
    )
    (tmp_path / "scan.ply").write_text(text, newline="")
    np.testing.assert_array_equal(read_scan(tmp_path / "scan.ply").points, [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])


def test_half_floats_and_plain_coordinates(tmp_path: Path):
    np.save(tmp_path / "scan.npy", xyz_of(SCENE).astype(np.float16))
    np.testing.assert_allclose(read_scan(tmp_path / "scan.npy").points, xyz_of(SCENE), rtol=1e-3, atol=1e-2)
    np.savez(tmp_path / "scan.npz", x=SCENE["x"], y=SCENE["y"], z=SCENE["z"])
    np.testing.assert_array_equal(read_scan(tmp_path / "scan.npz").points, xyz_of(SCENE))
    np.save(tmp_path / "scan.npy", np.asfortranarray(xyz_of(SCENE)))
    np.testing.assert_array_equal(read_scan(tmp_path / "scan.npy").points, xyz_of(SCENE))


def test_points_whose_time_is_marked_as_none(tmp_path: Path):
    late_s = SCENE["t"] / 1e9
    np.savez(tmp_path / "scan.npz", points=xyz_of(SCENE), timestamp=np.where(late_s < 0.01, 0.0, 1760000000.0 + late_s))
    found = read_scan(tmp_path / "scan.npz", 1760000000_000000000)
    np.testing.assert_allclose(found.offset_s, late_s[late_s >= 0.01], atol=1e-6)
    np.testing.assert_array_equal(found.points, xyz_of(SCENE)[late_s >= 0.01])


@pytest.mark.parametrize(
    ("light", "time"),
    [
        ("scalar_Intensity", "scalar_GpsTime"),  # CloudCompare
        ("i", "ts"),
        ("rssi", "time_stamp"),
        ("amplitude", "Relative_Timestamp"),
        ("intensities", "offset_ns"),
    ],
)
def test_names_of_intensity_and_time(tmp_path: Path, light: str, time: str):
    xyz = {axis: SCENE[axis] for axis in "xyz"}
    found = read_scan(write_pcd(tmp_path / "scan.pcd", xyz | {light: SCENE["intensity"], time: SCENE["t"]}))
    np.testing.assert_array_equal(found.intensity, SCENE["intensity"])
    np.testing.assert_allclose(found.offset_s, SCENE["t"] / 1e9, atol=1e-9)
    assert found.unused == ()


def test_fields_that_are_not_understood(tmp_path: Path):
    np.savez(tmp_path / "scan.npz", X=SCENE["x"], Y=SCENE["y"], Z=SCENE["z"], dt=SCENE["t"], intensity=SCENE["x"])
    assert read_scan(tmp_path / "scan.npz").unused == ("dt",)


def test_points_in_layers(tmp_path: Path):
    np.save(tmp_path / "scan.npy", xyz_of(SCENE).reshape(10, -1, 3))
    np.testing.assert_array_equal(read_scan(tmp_path / "scan.npy").points, xyz_of(SCENE))


# What is wrong with a scan is said in one line.


@pytest.mark.parametrize("suffix", sorted(SUFFIXES))
def test_an_empty_file(suffix: str, tmp_path: Path):
    (tmp_path / f"scan{suffix}").write_bytes(b"")
    assert "is empty (0 bytes)" in refusal(tmp_path / f"scan{suffix}")


def test_a_missing_file_and_a_folder(tmp_path: Path):
    assert "does not exist" in refusal(tmp_path / "scan.pcd")
    (tmp_path / "scan.npy").mkdir()
    assert "is a folder" in refusal(tmp_path / "scan.npy")


@pytest.mark.parametrize("form", FILE_FORMATS)
@pytest.mark.parametrize("share", [0.999, 0.7, 0.2])
def test_a_truncated_file(form: str, share: float, tmp_path: Path):
    suffix, write = FILE_FORMATS[form]
    path = write(tmp_path / f"scan{suffix}", SCENE)
    size = int(share * path.stat().st_size)
    path.write_bytes(path.read_bytes()[: size - (form == "kitti" and size % 16 == 0)])
    refusal(path)


@pytest.mark.parametrize("form", FLOATS)
def test_a_scan_of_which_nothing_is_finite(form: str, tmp_path: Path):
    suffix, write = FILE_FORMATS[form]
    nothing = {
        name: column * np.nan if column.dtype.kind == "f" and name != "intensity" else column
        for name, column in SCENE.items()
    }
    assert "none of its 300 points is finite" in refusal(write(tmp_path / f"scan{suffix}", nothing))


@pytest.mark.parametrize("form", FLOATS)
def test_a_scan_without_returns(form: str, tmp_path: Path):
    suffix, write = FILE_FORMATS[form]
    nothing = {name: column * 0 for name, column in SCENE.items()}
    assert "0 of 300 points have a return" in refusal(write(tmp_path / f"scan{suffix}", nothing))


@pytest.mark.parametrize("form", FILE_FORMATS)
def test_millimetres(form: str, tmp_path: Path):
    suffix, write = FILE_FORMATS[form]
    large = {name: column * 1000 if name in "xyz" else column for name, column in SCENE.items()}
    assert "millimetres" in refusal(write(tmp_path / f"scan{suffix}", large))


def test_zero_points(tmp_path: Path):
    empty = {name: column[:0] for name, column in SCENE.items()}
    for form in ("pcd ascii", "pcd binary", "ply big-endian", "las", "npy", "npz"):
        suffix, write = FILE_FORMATS[form]
        assert "0 points" in refusal(write(tmp_path / f"scan{suffix}", empty))


@pytest.mark.parametrize("form", [form for form in FILE_FORMATS if form != "kitti"])
def test_another_format_than_the_name_says(form: str, tmp_path: Path):
    suffix, write = FILE_FORMATS[form]
    for named in SUFFIXES - {suffix, ".las", ".laz"}:
        write(tmp_path / f"scan{suffix}", SCENE).rename(tmp_path / f"scan{named}")
        assert "file by its content" in refusal(tmp_path / f"scan{named}")


@pytest.mark.parametrize("suffix", sorted(SUFFIXES))
def test_a_pointer_of_git_lfs(suffix: str, tmp_path: Path):
    (tmp_path / f"scan{suffix}").write_text("version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 2\n")
    assert "is a pointer of Git LFS, not the file itself; needed is that" in refusal(tmp_path / f"scan{suffix}")


def test_no_format_at_all(tmp_path: Path):
    (tmp_path / "scan.pcd").write_bytes(b"<html>not found</html>")
    assert "is no PCD file" in refusal(tmp_path / "scan.pcd")
    (tmp_path / "scan.dat").write_bytes(b"\0\1\2\3")
    assert "of no known format" in refusal(tmp_path / "scan.dat")


@pytest.mark.parametrize("data", ["ascii", "binary", "binary_compressed"])
def test_a_pcd_header_that_promises_too_much(data: str, tmp_path: Path):
    (tmp_path / "scan.pcd").write_bytes(header(points=10**12, data=data) + b"1 2 3\n" * 10)
    assert "promises 1000000000000 points" in _without_memory(tmp_path / "scan.pcd")
    (tmp_path / "scan.pcd").write_bytes(
        header(points=10**7, data="binary_compressed") + struct.pack("<II", 8, 12 * 10**7) + b"1" * 8
    )
    assert "damaged" in _without_memory(tmp_path / "scan.pcd")


def test_other_headers_that_promise_too_much(tmp_path: Path):
    (tmp_path / "scan.ply").write_text(
        "ply\nformat binary_little_endian 1.0\nelement vertex 1000000000000\nproperty float x\nend_header\n1234"
    )
    assert "promises 1000000000000 points" in _without_memory(tmp_path / "scan.ply")
    with (tmp_path / "scan.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3)})
    assert "cut off" in _without_memory(tmp_path / "scan.npy")
    for suffix in (".las", ".laz"):
        content = bytearray(write_las(tmp_path / f"scan{suffix}", SCENE).read_bytes())
        struct.pack_into("<Q", content, 247, 10**12)
        (tmp_path / f"scan{suffix}").write_bytes(content)
        assert "promises 1000000000000 points" in _without_memory(tmp_path / f"scan{suffix}")
        struct.pack_into("<I", content, 100, 2**32 - 1)
        (tmp_path / f"scan{suffix}").write_bytes(content)
        assert "records" in _without_memory(tmp_path / f"scan{suffix}")


def test_layers_of_a_laz_that_promise_too_much(tmp_path: Path):
    """LAS 1.4's points lie in layers, whose sizes the decompressor takes memory for before it reads any."""
    path = write_las(tmp_path / "scan.laz", SCENE)
    content = bytearray(path.read_bytes())
    (start,) = struct.unpack_from("<I", content, 96)
    first_layer = start + 8 + 30 + 4  # the chunk table's place, a point of format 6, the number of points
    for layer in range(9):
        damaged = content.copy()
        struct.pack_into("<I", damaged, first_layer + 4 * layer, 2**32 - 1)
        path.write_bytes(damaged)
        assert f"a chunk at byte {start + 8} ends at" in _without_memory(path)


def test_a_laz_of_several_chunks_and_extra_bytes_is_read(tmp_path: Path):
    header = laspy.LasHeader(point_format=7, version="1.4")
    header.scales = np.full(3, 1e-4)
    header.add_extra_dims([laspy.ExtraBytesParams("ring", "u1"), laspy.ExtraBytesParams("range", "f8")])
    las = laspy.LasData(header)
    las.x, las.y, las.z = (np.tile(SCENE[axis].astype(np.float64), 400) for axis in "xyz")
    las.write(str(tmp_path / "scan.laz"))
    assert len(las.x) > 2 * 50_000  # the points of a chunk
    assert len(read_scan(tmp_path / "scan.laz")) == len(las.x)


def test_points_that_a_scale_makes_infinite_are_no_returns(tmp_path: Path):
    path = write_las(tmp_path / "scan.las", SCENE)
    content = bytearray(path.read_bytes())
    struct.pack_into("<3d", content, 131, 1e308, 1e308, 1e308)
    path.write_bytes(content)
    assert "none of its" in refusal(path)


def _without_memory(path: Path) -> str:
    tracemalloc.start()
    try:
        message = refusal(path)
        assert tracemalloc.get_traced_memory()[1] < 10_000_000
    finally:
        tracemalloc.stop()
    return message


def test_a_header_that_ends_within_the_number_of_its_records(tmp_path: Path):
    content = bytearray(write_las(tmp_path / "scan.las", SCENE).read_bytes())
    content[243:246] = b"\xff\xff\xff"
    (tmp_path / "scan.las").write_bytes(content[:246])
    assert "cut off: 246 bytes; the header alone has 375" in _without_memory(tmp_path / "scan.las")


def test_a_header_that_python_would_warn_of_is_refused(tmp_path: Path):
    path = tmp_path / "scan.npy"
    np.save(path, np.ones((5, 4)))
    path.write_bytes(path.read_bytes().replace(b"'<f8'", b"'<\\L'"))
    assert "its header holds a backslash" in refusal(path)


@pytest.mark.parametrize("suffix", [".npy", ".npz"])
def test_a_pickle_is_never_loaded(suffix: str, tmp_path: Path):
    class Trap:
        def __reduce__(self) -> tuple[object, tuple[str]]:
            return pytest.fail, ("the pickle was loaded",)

    array = np.array([Trap(), Trap()], dtype=object)
    (np.save if suffix == ".npy" else np.savez)(tmp_path / f"scan{suffix}", array, allow_pickle=True)
    assert "is a pickle" in refusal(tmp_path / f"scan{suffix}")


@pytest.mark.parametrize("crs", ["EPSG:32632", "EPSG:4326", "EPSG:25832+7837"])
def test_las_on_a_map(crs: str, tmp_path: Path):
    assert "these are world coordinates already" in refusal(write_las(tmp_path / "scan.laz", SCENE, CRS(crs)))


def test_las_whose_coordinates_are_on_a_map_though_it_does_not_say_so(tmp_path: Path):
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets = np.array([569_800.0, 5_363_700.0, 480.0])
    las = laspy.LasData(header)
    las.x, las.y, las.z = (SCENE[axis] + offset for axis, offset in zip("xyz", header.offsets, strict=True))
    las.write(str(tmp_path / "scan.las"))
    assert "coordinates on a map" in refusal(tmp_path / "scan.las")


def test_fields_without_coordinates(tmp_path: Path):
    np.save(tmp_path / "scan.npy", records_of({"x": SCENE["x"], "y": SCENE["y"], "range": SCENE["z"]}))
    assert "needed are x, y and z" in refusal(tmp_path / "scan.npy")
    np.save(tmp_path / "scan.npy", np.zeros((3, 300)).T[:, :2])
    assert "(300, 2)" in refusal(tmp_path / "scan.npy")
    np.save(tmp_path / "scan.npy", xyz_of(SCENE).T)
    assert "shape (3, 300); needed is one row for each point: transposed" in refusal(tmp_path / "scan.npy")
    np.savez(tmp_path / "scan.npz", a=np.zeros(3), b=np.zeros(3))
    assert "needed is 'points'" in refusal(tmp_path / "scan.npz")


def test_kitti_with_five_numbers_a_point(tmp_path: Path):
    np.column_stack([xyz_of(SCENE), SCENE["intensity"], SCENE["t"]]).astype("<f4").tofile(tmp_path / "scan.bin")
    assert "needed is an intensity" in refusal(tmp_path / "scan.bin")


def test_without_the_extra_it_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    path = write_las(tmp_path / "scan.laz", SCENE)
    monkeypatch.delitem(sys.modules, "laci_lidar.las", raising=False)
    monkeypatch.setitem(sys.modules, "laspy", None)
    assert "pip install 'laci-stereo[las]'" in refusal(path)


# Whatever the bytes are, the outcome is a scan or a refusal, and memory stays small.

LIMIT_BYTES = 100_000_000


def read_within_limits(path: Path) -> None:
    tracemalloc.start()
    try:
        scan = read_or_refused(lambda: read_scan(path), ScanError)
        assert tracemalloc.get_traced_memory()[1] < LIMIT_BYTES
    finally:
        tracemalloc.stop()
    if scan is not None:
        assert len(scan) > 0
        assert np.isfinite(scan.points).all()


@pytest.mark.parametrize("form", FILE_FORMATS)
def test_damaged_files_are_read_or_refused(form: str, tmp_path: Path):
    suffix, write = FILE_FORMATS[form]
    whole = write(tmp_path / f"whole{suffix}", scene(points=40)).read_bytes()

    @fuzz
    @given(mutations(whole))
    def damaged(content: bytes) -> None:
        (tmp_path / f"scan{suffix}").write_bytes(content)
        read_within_limits(tmp_path / f"scan{suffix}")

    damaged()


@fuzz
@given(
    suffix=st.sampled_from(sorted(SUFFIXES)),
    content=noise(
        "# .PCD\n", "FIELDS x y z\n", "SIZE 4 4 4\n", "TYPE F F F\n", "POINTS 1\n", "DATA ascii\n", "1 2 3\n", "ply\n"
    )
    | st.builds(
        lambda magic, rest: magic + rest,
        st.sampled_from([b"ply\nformat ascii 1.0\n", b"LASF", b"\x93NUMPY\x01\x00", b"PK\x03\x04", b"VERSION .7\n"]),
        st.binary(max_size=300),
    ),
)
def test_arbitrary_bytes_are_read_or_refused(suffix: str, content: bytes, tmp_path: Path):
    (tmp_path / f"scan{suffix}").write_bytes(content)
    read_within_limits(tmp_path / f"scan{suffix}")


@settings(deadline=None)
@given(st.lists(st.binary(min_size=1, max_size=12), min_size=1, max_size=40))
def test_lzf_is_undone(parts: list[bytes]):
    import lzf as reference  # what PCD's own tools use

    raw = b"".join(part * 9 for part in parts)
    packed = reference.compress(raw)
    if packed is not None and len(packed) < len(raw):
        assert lzf.decompress(packed, len(raw)) == raw
        with pytest.raises(ValueError, match="needed"):
            lzf.decompress(packed, len(raw) + 1)


@given(st.binary(max_size=60), st.integers(0, 1000))
def test_arbitrary_lzf_is_undone_or_refused(packed: bytes, size: int):
    try:
        assert len(lzf.decompress(packed, size)) == size
    except ValueError:
        return


def test_writers_of_npz_and_npy_agree(tmp_path: Path):
    scans = [
        read_scan(write(tmp_path / name, SCENE))
        for name, write in (
            ("a.npy", write_npy),
            ("b.npy", write_structured_npy),
            ("c.npz", write_npz),
            ("d.bin", write_bin),
        )
    ]
    for scan in scans[1:]:
        np.testing.assert_array_equal(scan.points, scans[0].points)
