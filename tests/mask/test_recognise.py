"""A network without a contract is recognised where its shapes leave no doubt, and it is said what was assumed."""

from __future__ import annotations

from pathlib import Path

import pytest

from laci_stereo.mask.errors import MaskError
from laci_stereo.mask.network import MaskOptions, Network
from laci_stereo.mask.recognise import Ports, Shape, recognise
from tests.mask import graphs

SIZE = (640, 640)
CELLS = 8400


def contract_of(*outputs: tuple[str, Shape], metadata: dict[str, str] | None = None):  # type: ignore[no-untyped-def]
    ports = Ports((("images", (1, 3, 640, 640)),), outputs, metadata or {})
    return recognise(Path("net.onnx"), ports, SIZE)


@pytest.mark.parametrize(
    ("outputs", "kind", "color", "ids"),
    [
        ((("output", (1, CELLS, 85)),), "yolox_raw", "BGR", (2, 3, 5, 7)),
        ((("output0", (1, 84, CELLS)),), "yolov8_raw", "RGB", (2, 3, 5, 7)),
        ((("output0", (1, 300, 6)),), "yolo_e2e", "RGB", (2, 3, 5, 7)),
        ((("output0", (1, 116, CELLS)), ("output1", (1, 32, 160, 160))), "yolo_seg", "RGB", (2, 3, 5, 7)),
        ((("logits", (1, 100, 92)), ("pred_boxes", (1, 100, 4))), "detr", "RGB", (3, 4, 6, 8)),
    ],
)
def test_the_unmistakable_ones_are_known(
    outputs: tuple[tuple[str, Shape], ...], kind: str, color: str, ids: tuple[int, ...]
) -> None:
    contract, words = contract_of(*outputs)
    assert (contract.kind, contract.input.color, contract.vehicle_ids) == (kind, color, ids)
    for word in (kind, color, outputs[0][0], str(ids[0])):
        assert word in words


def test_names_of_classes_in_the_file_tell_which_are_vehicles() -> None:
    names = {"names": "{0: 'person', 1: 'Car', 2: 'tree', 3: 'van'}"}
    assert contract_of(("output0", (1, 8, CELLS)), metadata=names)[0].vehicle_ids == (1, 3)


@pytest.mark.parametrize("names", ["{", "[1]", "__import__('os')", "{'a': 'car'}", "(" * 5000])
def test_names_that_are_none_are_not_believed(names: str) -> None:
    with pytest.raises(MaskError, match=r"4 classes, of which it is not known which are vehicles"):
        contract_of(("output0", (1, 8, CELLS)), metadata={"names": names})


@pytest.mark.parametrize(
    "outputs",
    [
        (("a", (1, 25200, 85)),),
        (("a", (1, 10, 4)), ("b", (1, 10))),
        (("a", (1, 21, 64, 64)),),
        (("a", ()),),
        (("a", (None, None, None)),),
    ],
)
def test_what_is_not_unmistakable_needs_a_contract(outputs: tuple[tuple[str, Shape], ...]) -> None:
    with pytest.raises(MaskError, match=r"needed is a contract, net\.contract\.json"):
        contract_of(*outputs)


def test_a_network_without_a_contract_runs_and_says_what_it_assumed(tmp_path: Path) -> None:
    network = Network(MaskOptions(graphs.save(graphs.yolo_e2e(), tmp_path, name="end")))
    assert "yolo_e2e" in network.assumed
