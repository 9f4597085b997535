"""The command line with a mask that is no good: exit code 2, one line, and nothing written."""

from __future__ import annotations

from pathlib import Path

from tests.cli_support import DEMONSTRATION, Site, refusal, run
from tests.mask import graphs

SITE = Site(DEMONSTRATION)


def test_a_mask_that_is_no_good_is_refused_before_the_long_work(tmp_path: Path) -> None:
    (tmp_path / "net.onnx").write_bytes(b"no network")
    arguments = ["calibrate", str(SITE.left), str(SITE.right), str(SITE.cam), "--out", str(tmp_path / "out")]
    ran = run([*arguments, "--vehicle-mask", str(tmp_path / "net.onnx")], tmp_path)
    refusal(ran, 2, "net.onnx", "is not an ONNX file")
    good = graphs.save(graphs.yolov8_raw(), tmp_path, {"kind": "yolov8_raw", "vehicle_ids": [1], "colour": "RGB"})
    refusal(run([*arguments, "--vehicle-mask", str(good)], tmp_path), 2, "unknown keys 'colour'")
    (tmp_path / "other.json").write_text("{}")
    refusal(
        run([*arguments, "--vehicle-mask", str(good), "--mask-contract", str(tmp_path / "other.json")], tmp_path),
        2,
        "other.json",
        "kind",
    )
    refusal(run([*arguments, "--mask-contract", "c.json"], tmp_path), 2, "needed is --vehicle-mask")
    assert not (tmp_path / "out").exists()


def test_looking_with_a_mask_that_is_no_good_is_refused(tmp_path: Path) -> None:
    model = graphs.save(
        graphs.constant_output(float("nan"), [1, 6, 64]), tmp_path, {"kind": "yolov8_raw", "vehicle_ids": [1]}
    )
    out = tmp_path / "look"
    refusal(run(["mask", str(model), str(SITE.left), "--out", str(out)], tmp_path), 2, "holds NaN")
    assert not out.exists()
