"""What stands in a file is quoted within one short line, whatever it is."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.io.text_file import listed, quoted, shortened

LONG = st.one_of(st.text(), st.text(min_size=1).map(lambda text: 5000 * text))


@given(st.lists(LONG, max_size=30), st.integers(3, 400))
def test_no_quotation_is_long_or_of_several_lines(texts: list[str], most: int) -> None:
    assert len(listed(texts)) < 600
    assert len(listed(texts).splitlines()) <= 1
    for text in texts:
        assert len(shortened(text, most)) <= most
        assert len(shortened(text, most).splitlines()) <= 1
        assert len(quoted(text).splitlines()) == 1


def test_short_words_stay_as_they_are() -> None:
    assert shortened("three words, two commas,") == "three words, two commas,"
    assert shortened("a" * 400, 10) == "aaaaaaa..."
    assert listed(["x", "y z"]) == "x, y z"
    assert listed(["x"] * 22) == ", ".join(["x"] * 20) + " and 2 more"
