"""What the benchmark of masks says of results."""

from __future__ import annotations

from tools.bench_mask import Row, report


def test_like_is_compared_with_like() -> None:
    rows = [
        Row(1, "without", "", 10.0, 0.4, 1.0, 3.5),
        Row(2, "without", "MatchError: no", 0.0),
        Row(1, "with", "", 5.0, 0.2, 1.0, 1.5, kept=3, dropped=1),
        Row(2, "with", "", 50.0, 2.0, 3.5, 1.0),
        *(Row(seed, other, "verdict fail") for seed in (1, 2) for other in ("shifted", "third missing", "false boxes")),
        Row(3, "all wrong", "", 7.0, 0.7, 0.1, 0.1),
    ]
    lines = [[cell.strip() for cell in line.split("|")[1:-1]] for line in report(rows).splitlines()]
    assert {len(line) for line in lines} == {13}
    (without,), (right,), (shifted,), (wrong,) = (
        [line[1:] for line in lines if line[0] == name] for name in ("without", "with", "shifted", "all wrong")
    )
    assert without[:2] == ["2", "1"]
    assert without[6] == "0, 1"
    assert right[6:10] == ["1, 0", "3.5, 1.5", "25%", "1"]
    assert right[10:] == ["10.0 -> 5.0", "0.40 -> 0.20"]
    assert shifted == ["2", "2", *[""] * 10]
    assert wrong[9:] == ["0", "", ""]
