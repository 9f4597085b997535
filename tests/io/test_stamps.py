from __future__ import annotations

from datetime import datetime, timezone
from decimal import Decimal

import pytest
from hypothesis import given
from hypothesis import strategies as st

from laci_stereo.io.stamps import UNITS, iso_text, iso_time, number, unit_of


@given(st.integers(0, 4 * 10**18))
def test_iso_times_come_back_exactly(ns: int) -> None:
    moment = datetime.fromtimestamp(ns // 10**9, timezone.utc)
    text = f"{moment:%Y-%m-%dT%H:%M:%S}.{ns % 10**9:09d}"
    for zone, has_zone in (("Z", True), ("", False), ("+00:00", True)):
        found = iso_time(text + zone)
        assert found is not None
        assert (found.ns, found.has_zone) == (ns, has_zone)


@given(st.integers(0, 4 * 10**18), st.integers(-14 * 60, 14 * 60))
def test_an_offset_only_says_where_the_clock_hangs(ns: int, minutes: int) -> None:
    local = datetime.fromtimestamp(ns // 10**9 + minutes * 60, timezone.utc)
    sign = "-" if minutes < 0 else "+"
    text = f"{local:%Y-%m-%d %H:%M:%S},{ns % 10**9:09d}{sign}{abs(minutes) // 60:02d}:{abs(minutes) % 60:02d}"
    found = iso_time(text)
    assert found is not None
    assert found.ns == ns


@pytest.mark.parametrize(
    "text",
    [
        "2011-09-26 13:02:25.5 UTC",
        "2011-09-26 13:02:25.5 GMT",
        "2011/09/26 13:02:25.5Z",
        "26.09.2011 13:02:25,5Z",
        "26.09.2011 15:02:25,5 +02:00",
    ],
)
def test_dates_and_zones_in_other_words(text: str) -> None:
    found = iso_time(text)
    assert found is not None
    assert (found.ns, found.has_zone) == (1317042145_500000000, True)


@pytest.mark.parametrize("text", ["09/26/2011 13:02:25", "26.09.11 13:02:25", "2011-09-26 13:02:25 CEST"])
def test_what_may_be_another_date_or_zone_is_no_time(text: str) -> None:
    assert iso_time(text) is None


@pytest.mark.parametrize(
    "text", ["2011-13-26 13:02:25", "2011-09-26", "13:02:25", "1200-01-01T00:00:00Z", "٢٠١١-09-26T13:02:25"]
)
def test_what_is_no_iso_time(text: str) -> None:
    assert iso_time(text) is None


@pytest.mark.parametrize("text", ["", "1_000", "nan", "inf", "0x10", "1,5", "1e9999", "٣", "."])
def test_what_is_no_number(text: str) -> None:
    assert number(text) is None


@pytest.mark.parametrize(("unit", "digits"), list(zip(UNITS, (10, 13, 16, 19), strict=True)))
def test_units_of_today(unit: object, digits: int) -> None:
    assert unit_of([Decimal(10 ** (digits - 1) + 7)]) is unit


def test_iso_text_rounds_to_the_millisecond() -> None:
    assert iso_text(1760000000_123456789) == "2025-10-09T08:53:20.123Z"
