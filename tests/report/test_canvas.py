from __future__ import annotations

import numpy as np
import pytest

from laci_stereo.report.canvas import Canvas, as_bgr8, emptiest_corner
from laci_stereo.report.style import BLACK, NIGHT, VERMILLION, WHITE, YELLOW, Stroke, lane_strokes
from tests.report.support import lane, lane_map


def blank(width: int = 1280, height: int = 720) -> Canvas:
    return Canvas(np.full((height, width, 3), 200, dtype=np.uint8), halo=NIGHT)


def test_a_canvas_leaves_the_image_it_is_made_of_alone() -> None:
    image = np.full((48, 64, 3), 200, dtype=np.uint8)
    canvas = Canvas(image, halo=NIGHT)
    canvas.lines([np.array([[0.0, 0.0], [60.0, 40.0]])], Stroke(YELLOW, 3.0))
    assert (image == 200).all()
    assert (canvas.image != 200).any()


def test_grey_becomes_three_equal_channels() -> None:
    grey = np.arange(12, dtype=np.uint8).reshape(3, 4)
    np.testing.assert_array_equal(as_bgr8(grey), np.repeat(grey[:, :, None], 3, axis=2))


def test_sixteen_bits_are_stretched_to_the_brightest() -> None:
    image = np.array([[0, 2048, 4095]], dtype=np.uint16)
    assert as_bgr8(image)[0, :, 0].tolist() == [0, 128, 255]


def test_a_line_is_of_its_colour_with_a_rim_around() -> None:
    canvas = blank()
    canvas.lines([np.array([[100.0, 300.0], [1000.0, 300.0]])], Stroke(VERMILLION, 3.0))
    column = canvas.image[290:311, 500]
    assert column[10].tolist() == list(VERMILLION)
    assert column[:10].max(axis=1).min() < 100
    assert column[11:].max(axis=1).min() < 100
    assert column[0].tolist() == column[20].tolist() == [200, 200, 200]


def test_a_dashed_line_has_gaps_of_its_unit() -> None:
    canvas = blank()
    canvas.lines([np.array([[100.0, 300.0], [1000.0, 300.0]])], Stroke(VERMILLION, 1.0, dash=(40.0, 30.0)))
    row = (canvas.image[300, 100:1000] == VERMILLION).all(axis=1)
    starts = np.flatnonzero(np.diff(row.astype(int)) == 1)
    np.testing.assert_allclose(np.diff(starts), 70.0, atol=1.0)


@pytest.mark.parametrize(("width", "height"), [(640, 480), (3840, 2160)])
def test_type_grows_with_the_picture(width: int, height: int) -> None:
    share = blank(width, height).text_width("10 m grid") / np.sqrt(width * height)
    assert share == pytest.approx(blank().text_width("10 m grid") / 960.0, rel=0.05)


def test_a_line_of_type_shrinks_to_its_room() -> None:
    canvas = blank()
    text = "a line that is much too long for its room"
    assert 170.0 <= canvas.text_width(text, canvas.fitting(text, 200.0)) <= 200.0
    assert canvas.fitting("short", 200.0, 20.0) == 20.0


@pytest.mark.parametrize("align", ["left", "centre", "right"])
def test_type_stands_where_it_is_put(align: str) -> None:
    canvas = Canvas(np.full((200, 800, 3), 255, dtype=np.uint8), halo=WHITE)
    canvas.text("HHHHH", (400.0, 100.0), BLACK, align=align)  # type: ignore[arg-type]
    rows, columns = np.nonzero(canvas.image[:, :, 0] < 100)
    assert (rows.min() + rows.max()) / 2 == pytest.approx(100.0, abs=1.5)
    anchor = {"left": columns.min(), "centre": (columns.min() + columns.max()) / 2, "right": columns.max()}[align]
    assert anchor == pytest.approx(400.0, abs=3.0)


def test_specks_beyond_the_border_are_dropped() -> None:
    canvas = blank()
    canvas.specks(np.array([[5.0, 7.0], [-1.0, 7.0], [1280.0, 7.0], [5.0, 720.0]]), YELLOW)
    rows, columns = np.nonzero((canvas.image == YELLOW).all(axis=2))
    assert (rows.tolist(), columns.tolist()) == ([7], [5])


def test_what_is_drawn_faintly_is_a_mixture() -> None:
    canvas = blank()
    with canvas.faint(0.5):
        canvas.area(np.array([[10.0, 10.0], [50.0, 10.0], [50.0, 50.0], [10.0, 50.0]]), BLACK)
    assert canvas.image[30, 30].tolist() == [100, 100, 100]
    assert canvas.image[100, 100].tolist() == [200, 200, 200]


def test_nothing_is_drawn_beyond_a_part_of_the_canvas() -> None:
    canvas = blank()
    with canvas.within((100.0, 100.0, 300.0, 200.0)) as part:
        part.lines([np.array([[-500.0, 50.0], [900.0, 50.0]])], Stroke(YELLOW, 3.0))
    _, columns = np.nonzero((canvas.image == YELLOW).all(axis=2))
    assert (columns.min(), columns.max()) == (100, 299)


def test_a_panel_takes_the_corner_in_which_it_hides_nothing_and_first_of_all_not_the_vehicle() -> None:
    inside = (0.0, 0.0, 100.0, 100.0)
    vehicle = np.array([[5.0, 5.0], [95.0, 5.0], [5.0, 95.0]])
    lanes = np.array([[95.0, 95.0]])
    assert emptiest_corner((20.0, 20.0), inside, [vehicle, lanes]) == (80.0, 80.0)
    assert emptiest_corner((20.0, 20.0), inside, [vehicle[:1], vehicle[:2]]) == (0.0, 80.0)


def test_lines_look_as_on_the_road_and_virtual_ones_lie_below() -> None:
    lines = [
        lane((0, 0), (1, 0)),
        lane((0, 0), (1, 0), kind="virtual"),
        lane((0, 0), (1, 0), subtype="dashed"),
        lane((0, 0), (1, 0), kind="stop_line"),
    ]
    (virtual, dotted), (_, solid), (_, dashed), (_, stop) = lane_strokes(lane_map(*lines), YELLOW, 2.0)
    assert virtual.kind == "virtual"
    assert dotted.width < solid.width == dashed.width == 2.0 < stop.width
    assert solid.dash is None
    assert dashed.dash is not None
    assert lane_strokes(None, YELLOW, 2.0) == []
