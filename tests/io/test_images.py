from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.core.errors import ImageError
from laci_stereo.io.image_size import stated_bits, stated_size
from laci_stereo.io.images import ImageFolder, pair_images, read_image
from tests.io.images import png_bomb
from tests.io.support import SHARED, fuzz, mutations, needs_shared, noise, read_or_refused, write_images

START_NS = 1760000000_000000000
PERIOD_NS = 100_000_000
RNG = np.random.default_rng(7)
SCENE = cv2.GaussianBlur(RNG.integers(0, 256, (48, 64, 3), dtype=np.uint8), (5, 5), 1.0)
IN_COLOUR = [".png", ".tif", ".tiff", ".bmp", ".ppm"]
IN_GREY = [".png", ".tif", ".pgm"]


def encoded(image: np.ndarray, suffix: str, *parameters: int) -> bytes:
    done, content = cv2.imencode(suffix, image, parameters)
    assert done
    return content.tobytes()


def folder_at(path: Path, stamps_ns: list[int]) -> ImageFolder:
    """Return a folder as the pairing sees it, which reads no file."""
    return ImageFolder(path, tuple(path / f"{ns}.png" for ns in stamps_ns), np.array(stamps_ns, dtype=np.int64))


def test_a_folder_is_in_the_order_of_time_not_of_names(tmp_path: Path) -> None:
    folder = write_images(tmp_path / "left", ["b_1760000000100.png", "a_1760000000200.PNG", "c_1760000000000.jpg"])
    (folder / ".1760000000050.png").write_bytes(b"hidden")
    (folder / "notes.txt").write_text("other")
    (folder / "1760000000999.png").mkdir()
    images = ImageFolder.open(folder)
    assert [file.name[0] for file in images.files] == ["c", "b", "a"]
    assert images.stamps_ns.tolist() == [START_NS, START_NS + PERIOD_NS, START_NS + 2 * PERIOD_NS]
    assert (len(images), images.period_ns) == (3, PERIOD_NS)


def test_two_images_of_one_time_are_named(tmp_path: Path) -> None:
    folder = write_images(tmp_path, ["1760000000.5.png", "a1760000000.50.png", "1760000001.png"])
    with pytest.raises(ImageError, match=r"1760000000\.5\.png and a1760000000\.50\.png have the same time"):
        ImageFolder.open(folder)


def test_what_is_no_folder_of_images(tmp_path: Path) -> None:
    with pytest.raises(ImageError, match="left does not exist"):
        ImageFolder.open(tmp_path / "left")
    (tmp_path / "file").write_text("x")
    with pytest.raises(ImageError, match="file is a file; needed is a folder"):
        ImageFolder.open(tmp_path / "file")
    (tmp_path / "empty").mkdir()
    with pytest.raises(ImageError, match="empty is empty"):
        ImageFolder.open(tmp_path / "empty")
    (tmp_path / "texts").mkdir()
    (tmp_path / "texts" / "1760000000.txt").write_text("x")
    with pytest.raises(ImageError, match="texts holds 1 files but no image"):
        ImageFolder.open(tmp_path / "texts")


@given(st.integers(2, 40), st.integers(-49_000_000, 49_000_000))
def test_every_frame_finds_its_partner_whatever_the_shift_below_half_a_period(n: int, shift: int) -> None:
    left = [START_NS + i * PERIOD_NS for i in range(n)]
    pairs = pair_images(folder_at(Path("left"), left), folder_at(Path("right"), [ns + shift for ns in left]))
    assert [(pair.stamp_ns, int(pair.right.stem)) for pair in pairs.pairs] == [(ns, ns + shift) for ns in left]
    assert (pairs.unpaired_left, pairs.unpaired_right) == (0, 0)


STAMPS = st.lists(st.integers(START_NS, START_NS + 60 * PERIOD_NS), min_size=2, max_size=30, unique=True).map(sorted)


@fuzz
@given(STAMPS, STAMPS)
def test_pairs_are_one_to_one_near_and_counted(left: list[int], right: list[int]) -> None:
    folders = folder_at(Path("left"), left), folder_at(Path("right"), right)
    pairs = read_or_refused(lambda: pair_images(*folders), ImageError)
    if pairs is None:
        return
    lefts, rights = [pair.left for pair in pairs.pairs], [pair.right for pair in pairs.pairs]
    assert len(set(lefts)) == len(set(rights)) == len(pairs)
    assert (len(pairs) + pairs.unpaired_left, len(pairs) + pairs.unpaired_right) == (len(left), len(right))
    tolerance = min(folder.period_ns for folder in folders) / 2
    for pair in pairs.pairs:
        gap = abs(int(pair.right.stem) - pair.stamp_ns)
        assert pair.stamp_ns == int(pair.left.stem)
        assert gap <= tolerance
        assert gap == min(abs(ns - pair.stamp_ns) for ns in right)


def test_dropped_frames_stay_without_a_partner() -> None:
    left = [START_NS + i * PERIOD_NS for i in range(20)]
    right = [ns + 1_000_000 for i, ns in enumerate(left) if i not in (0, 7, 19)]
    pairs = pair_images(folder_at(Path("left"), left), folder_at(Path("right"), right))
    assert (len(pairs), pairs.unpaired_left, pairs.unpaired_right) == (17, 3, 0)
    assert START_NS + 7 * PERIOD_NS not in {pair.stamp_ns for pair in pairs.pairs}


def test_recordings_of_different_hours_are_refused_with_both_intervals() -> None:
    left = [START_NS + i * PERIOD_NS for i in range(5)]
    right = [ns + 3600 * 10**9 for ns in left]
    with pytest.raises(ImageError) as refused:
        pair_images(folder_at(Path("left"), left), folder_at(Path("right"), right))
    message = str(refused.value)
    assert "0 pairs" in message
    assert "left (5 images) spans 2025-10-09T08:53:20.000Z to 2025-10-09T08:53:20.400Z" in message
    assert "right (5 images) spans 2025-10-09T09:53:20.000Z to 2025-10-09T09:53:20.400Z" in message
    assert "difference 3600.0 s" in message


def test_too_few_partners_are_refused() -> None:
    left = [START_NS + i * PERIOD_NS for i in range(20)]
    assert len(pair_images(folder_at(Path("l"), left), folder_at(Path("r"), left[:10]))) == 10
    with pytest.raises(ImageError, match=r"9 pairs are within half a frame period \(50\.0 ms\)"):
        pair_images(folder_at(Path("l"), left), folder_at(Path("r"), left[:9]))
    with pytest.raises(ImageError, match="r holds 1 image; needed are at least 2"):
        pair_images(folder_at(Path("l"), left), folder_at(Path("r"), left[:1]))


@pytest.mark.parametrize(
    ("suffix", "image"),
    [*((suffix, SCENE) for suffix in IN_COLOUR), *((suffix, SCENE[:, :, 0]) for suffix in IN_GREY)],
)
def test_pixels_come_back_exactly(tmp_path: Path, suffix: str, image: np.ndarray) -> None:
    file = tmp_path / f"x{suffix}"
    file.write_bytes(encoded(image, suffix))
    found = read_image(file)
    assert found.dtype == np.uint8
    np.testing.assert_array_equal(found, image)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pgm"])
def test_sixteen_bits_stay_sixteen_bits(tmp_path: Path, suffix: str) -> None:
    image = SCENE[:, :, 0].astype(np.uint16) * 257
    file = tmp_path / f"x{suffix}"
    file.write_bytes(encoded(image, suffix))
    found = read_image(file)
    assert found.dtype == np.uint16
    np.testing.assert_array_equal(found, image)


def test_alpha_is_dropped(tmp_path: Path) -> None:
    file = tmp_path / "x.png"
    file.write_bytes(encoded(np.dstack([SCENE, np.full(SCENE.shape[:2], 9, dtype=np.uint8)]), ".png"))
    np.testing.assert_array_equal(read_image(file), SCENE)


@pytest.mark.parametrize("channels", [1, 3])
@pytest.mark.parametrize(("kind", "bits"), [("float32", 32), ("float64", 64), ("int32", 32)])
def test_longer_pixels_are_refused_before_they_are_decoded(
    tmp_path: Path, kind: str, bits: int, channels: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = tmp_path / "x.tiff"
    file.write_bytes(encoded(SCENE[:, :, :channels].astype(kind), ".tiff"))
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    with pytest.raises(ImageError, match=rf"x\.tiff has pixels of {bits} bits; needed are 8 or 16 bit integers"):
        read_image(file)


def test_pixels_with_a_sign_are_refused(tmp_path: Path) -> None:
    file = tmp_path / "x.tiff"
    file.write_bytes(encoded(SCENE.astype(np.int16), ".tiff"))
    with pytest.raises(ImageError, match=r"x\.tiff has pixels of type int16; needed are 8 or 16 bit integers"):
        read_image(file)


@pytest.mark.parametrize("suffix", [*IN_COLOUR, ".jpg", ".pgm", ".webp"])
@pytest.mark.parametrize("share", [0.02, 0.3, 0.7, 0.97])
def test_an_image_that_was_cut_off_is_refused_in_one_line(
    tmp_path: Path, suffix: str, share: float, capfd: pytest.CaptureFixture[str]
) -> None:
    whole = encoded(SCENE[:, :, 0] if suffix in IN_GREY else SCENE, suffix)
    file = tmp_path / f"x{suffix}"
    file.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(ImageError, match=rf"x\{suffix} .*; needed is a whole image"):
        read_image(file)
    assert capfd.readouterr().err == ""


def test_a_jpeg_that_promises_more_pixels_than_its_bytes_can_hold_is_not_decoded(tmp_path: Path) -> None:
    content = bytearray(encoded(SCENE, ".jpg"))
    frame = content.index(b"\xff\xc0")
    content[frame + 5 : frame + 9] = (17000).to_bytes(2, "big") + (30000).to_bytes(2, "big")
    (tmp_path / "x.jpg").write_bytes(content)
    with pytest.raises(ImageError, match=rf"promises 30000 x 17000 pixels in {len(content)} bytes"):
        read_image(tmp_path / "x.jpg")


@pytest.mark.parametrize("suffix", [*IN_COLOUR, ".jpg", ".pgm", ".webp"])
@pytest.mark.parametrize("shape", [(48, 64), (1, 1), (7, 300), (257, 3)])
def test_the_size_that_a_file_states_is_that_of_its_pixels(suffix: str, shape: tuple[int, int]) -> None:
    image = RNG.integers(0, 256, (*shape, 3), dtype=np.uint8)
    content = encoded(image[:, :, 0] if suffix == ".pgm" else image, suffix)
    assert stated_size(content) == shape[::-1]
    if suffix == ".webp":
        assert stated_size(encoded(image, suffix, cv2.IMWRITE_WEBP_QUALITY, 50)) == shape[::-1]
    for length in range(40):
        assert stated_size(content[:length]) in (None, shape[::-1])


@pytest.mark.parametrize("order", "<>")
@pytest.mark.parametrize("big", [False, True])
@pytest.mark.parametrize("kind", ["H", "I"])
def test_the_size_that_a_tiff_states_in_all_its_ways(order: str, big: bool, kind: str) -> None:
    head = (b"II" if order == "<" else b"MM") + struct.pack(order + "H", 43 if big else 42)
    head += struct.pack(order + ("HHQ" if big else "I"), *((8, 0, 16) if big else (8,)))
    told = {254: 0, 256: 30_000, 257: 40_000, 258: 8}
    entries = b"".join(
        struct.pack(order + ("HHQ" if big else "HHI"), tag, {"H": 3, "I": 4}[kind], 1)
        + struct.pack(order + kind, value).ljust(8 if big else 4, b"\0")
        for tag, value in told.items()
    )
    content = head + struct.pack(order + ("Q" if big else "H"), len(told)) + entries
    assert stated_size(content) == (30_000, 40_000)
    assert stated_bits(content) == 8


STARTS = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"II*\0", b"MM\0+\0\x08\0\0", b"BM", b"RIFFaaaaWEBPVP8X", b"P6 ")


@pytest.mark.parametrize("suffix", [*IN_COLOUR, ".jpg", ".webp"])
def test_of_any_bytes_a_size_or_none_is_stated(suffix: str) -> None:
    whole = encoded(SCENE[:8, :8], suffix)

    @fuzz
    @given(st.one_of(mutations(whole), st.builds(bytes.__add__, st.sampled_from(STARTS), st.binary(max_size=60))))
    def check(content: bytes) -> None:
        size = stated_size(content)
        assert size is None or min(size) >= 0

    check()


def test_one_folder_is_no_pair(tmp_path: Path) -> None:
    left = folder_at(tmp_path / "left", [START_NS, START_NS + PERIOD_NS])
    again = folder_at(tmp_path / "x" / ".." / "left", [START_NS, START_NS + PERIOD_NS])
    with pytest.raises(ImageError, match="is given for the left and the right images; needed are two folders"):
        pair_images(left, again)


def patched(content: bytes, size: tuple[int, ...], form: str, at: int) -> bytes:
    raw = struct.pack(form, *size)
    return content[:at] + raw + content[at + len(raw) :]


def tiff_of(size: tuple[int, int]) -> bytes:
    content = encoded(SCENE, ".tif")
    for tag, old, new in ((256, SCENE.shape[1], size[0]), (257, SCENE.shape[0], size[1])):
        entry = struct.pack("<HHII", tag, 3, 1, old)
        assert content.count(entry) == 1
        content = content.replace(entry, struct.pack("<HHII", tag, 4, 1, new))
    return content


BOMBS = {
    "x.png": lambda: png_bomb(40_000, 20_000),
    "x.jpg": lambda: encoded(np.zeros((10_001, 10_000), dtype=np.uint8), ".jpg"),
    "x.tiff": lambda: tiff_of((40_000, 20_000)),
    "x.webp": lambda: patched(encoded(SCENE, ".webp", cv2.IMWRITE_WEBP_QUALITY, 50), (16_000, 16_000), "<HH", 26),
    "lossless.webp": lambda: patched(encoded(SCENE, ".webp"), (15_999 | 15_999 << 14,), "<I", 21),
    "x.bmp": lambda: patched(patched(encoded(SCENE, ".bmp"), (40_000, 20_000), "<ii", 18), (1, 0), "<II", 30),
}
"""Small files that would decode into gigabytes; the BMP says that its runs are packed."""


@pytest.mark.parametrize("name", BOMBS)
def test_an_image_of_more_pixels_than_cameras_have_is_not_decoded(
    tmp_path: Path, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    content = BOMBS[name]()
    (tmp_path / name).write_bytes(content)
    monkeypatch.setattr(cv2, "imdecode", lambda *_: pytest.fail("decoded"))
    with pytest.raises(ImageError, match=r"has \d+ x \d+ pixels; needed are at most 100 megapixels") as refused:
        read_image(tmp_path / name)
    assert len(str(refused.value).splitlines()) == 1
    assert len(content) < 2_000_000


def test_what_is_no_known_format_is_not_decoded(tmp_path: Path) -> None:
    """OpenCV reads more formats than we know the headers of; their content, under whatever name, may state any size."""
    (tmp_path / "x.png").write_bytes(encoded(SCENE, ".hdr"))
    with pytest.raises(ImageError, match=r"x\.png cannot be decoded"):
        read_image(tmp_path / "x.png")


@pytest.mark.parametrize("progressive", [0, 1])
def test_a_jpeg_of_one_colour_holds_as_many_pixels_as_any(progressive: int, tmp_path: Path) -> None:
    """Nothing is written in less bytes than an image in which every block is the same."""
    flags = [cv2.IMWRITE_JPEG_QUALITY, 1, cv2.IMWRITE_JPEG_PROGRESSIVE, progressive, cv2.IMWRITE_JPEG_OPTIMIZE, 1]
    assert cv2.imwrite(str(tmp_path / "x.jpg"), np.zeros((3000, 4000), dtype=np.uint8), flags)
    assert read_image(tmp_path / "x.jpg").shape[:2] == (3000, 4000)


def test_a_jpeg_ends_at_its_own_end_and_not_at_that_of_its_thumbnail(tmp_path: Path) -> None:
    photo = encoded(SCENE, ".jpg")
    thumbnail = encoded(SCENE[::4, ::4], ".jpg")
    exif = b"\xff\xe1" + (len(thumbnail) + 2).to_bytes(2, "big") + thumbnail
    with_thumbnail = photo[:2] + exif + photo[2:]
    file = tmp_path / "x.jpg"
    file.write_bytes(with_thumbnail + bytes(64))
    assert read_image(file).shape == SCENE.shape
    file.write_bytes(with_thumbnail[:-200])
    with pytest.raises(ImageError, match=r"is cut off .* JPEG without its end"):
        read_image(file)


def test_a_flipped_bit_in_a_png_is_found(tmp_path: Path) -> None:
    content = bytearray(encoded(SCENE, ".png"))
    content[len(content) // 2] ^= 1
    (tmp_path / "x.png").write_bytes(content)
    with pytest.raises(ImageError, match=r"x\.png is damaged \(checksum"):
        read_image(tmp_path / "x.png")


def test_what_is_no_image_is_refused(tmp_path: Path) -> None:
    file = tmp_path / "x.png"
    with pytest.raises(ImageError, match=r"x\.png does not exist; needed is an image"):
        read_image(file)
    file.write_bytes(b"")
    with pytest.raises(ImageError, match=r"x\.png is empty"):
        read_image(file)
    file.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:1\nsize 2\n")
    with pytest.raises(ImageError, match=r"x\.png is a pointer of Git LFS, not the file itself"):
        read_image(file)
    file.write_text("not an image")
    with pytest.raises(ImageError, match=r"x\.png cannot be decoded \(12 bytes\)"):
        read_image(file)
    with pytest.raises(ImageError, match="is a folder"):
        read_image(tmp_path)


@pytest.mark.parametrize("suffix", [".png", ".bmp", ".pgm"])
def test_a_mutated_image_is_read_or_refused(tmp_path: Path, suffix: str) -> None:
    whole = encoded(SCENE[:8, :8, 0], suffix)

    @fuzz
    @given(st.one_of(mutations(whole), noise("P5", "P4", "BM", " 2", "\n", "255", "#")))
    def check(content: bytes) -> None:
        file = tmp_path / f"x{suffix}"
        file.write_bytes(content)
        image = read_or_refused(lambda: read_image(file), ImageError)
        assert image is None or image.ndim in (2, 3)

    check()


@needs_shared
def test_the_shared_recordings() -> None:
    for name, pairs in (("crossing", 110), ("crossing_b", None)):
        folders = [ImageFolder.open(SHARED / "data" / name / side) for side in ("left", "right")]
        found = pair_images(*folders)
        assert len(found) == len(folders[0]) == (pairs or len(folders[0]))
        assert read_image(found.pairs[0].left).shape == (720, 1280, 3)
