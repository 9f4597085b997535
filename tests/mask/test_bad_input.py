"""What is wrong with a network or its contract is one line that names what was found and what is needed."""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest

from laci_stereo.mask.contract import read_contract, schema
from laci_stereo.mask.errors import MaskError
from laci_stereo.mask.model_file import free_memory
from laci_stereo.mask.network import MaskOptions, Network, Provider
from tests.mask import graphs

CONTRACT: dict[str, Any] = {"kind": "yolov8_raw", "vehicle_ids": [1]}


def refused(path: Path, contract: Path | None = None, provider: Provider = "cpu") -> str:
    with pytest.raises(MaskError) as caught:
        Network(MaskOptions(path, contract, provider))
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    return message


def test_a_good_network_is_taken(tmp_path: Path) -> None:
    network = Network(MaskOptions(graphs.save(graphs.yolov8_raw(), tmp_path, CONTRACT)))
    assert network.size == (graphs.SIDE, graphs.SIDE)
    assert network.assumed == ""


@pytest.mark.parametrize("content", [b"", b"\x00" * 100, b"PK\x03\x04 a zip", b"{}", os.urandom(999)])
def test_what_is_no_onnx_file_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "net.onnx"
    path.write_bytes(content)
    assert "needed is" in refused(path)
    assert str(path) in refused(path)


def test_a_missing_file_and_a_folder_are_refused(tmp_path: Path) -> None:
    assert "No such file" in refused(tmp_path / "net.onnx")
    assert "is a folder" in refused(tmp_path)


def test_a_file_that_is_cut_off_is_refused(tmp_path: Path) -> None:
    path = graphs.save(graphs.yolov8_raw(), tmp_path, CONTRACT)
    os.truncate(path, path.stat().st_size // 2)
    assert "is not an ONNX file" in refused(path)


def test_an_operator_that_the_runtime_lacks_is_named(tmp_path: Path) -> None:
    graph = graphs.Graph()
    graph.node("Unheard", "images", name="output")
    assert "Unheard" in refused(graphs.save(graph.model(["output"], opset=16), tmp_path, CONTRACT))


@pytest.mark.parametrize(
    "change",
    [{"x" * 5000: 1}, {"kind": "x" * 5000}, {"vehicle_ids": ["x" * 5000]}, dict.fromkeys(map(str, range(5000)))],
)
def test_a_mistake_at_length_is_said_in_short(change: dict[str, Any], tmp_path: Path) -> None:
    path = tmp_path / "net.contract.json"
    path.write_text(json.dumps({**CONTRACT, **change}))
    with pytest.raises(MaskError) as caught:
        read_contract(path)
    assert len(str(caught.value)) < 1000


def test_an_opset_that_the_runtime_lacks_is_named(tmp_path: Path) -> None:
    graph = graphs.Graph()
    graph.node("Identity", "images", name="output")
    message = refused(graphs.save(graph.model(["output"], opset=999), tmp_path, CONTRACT))
    assert "cannot be loaded" in message
    assert "999" in message


def external(folder: Path, location: str, size: int = 4) -> Path:
    """Write a network one of whose weights is external data."""
    graph = graphs.Graph()
    weight = onnx.TensorProto(name="weight", data_type=onnx.TensorProto.FLOAT, dims=[size // 4])
    weight.data_location = onnx.TensorProto.EXTERNAL
    for key, value in (("location", location), ("offset", "0"), ("length", str(size))):
        weight.external_data.add(key=key, value=value)
    graph.constants.append(weight)
    graph.node("Mul", "images", "weight", name="output")
    return graphs.save(graph.model(["output"], opset=16), folder, CONTRACT)


def test_external_data_that_are_missing_are_named(tmp_path: Path) -> None:
    message = refused(external(tmp_path, "weights.bin"))
    assert "weights.bin" in message
    assert "missing" in message


@pytest.mark.parametrize("location", ["../weights.bin", "/etc/hostname", "sub/../../weights.bin", "link.bin"])
def test_external_data_outside_of_the_folder_are_refused(location: str, tmp_path: Path) -> None:
    (tmp_path / "weights.bin").write_bytes(bytes(4))
    folder = tmp_path / "model"
    folder.mkdir()
    (folder / "link.bin").symlink_to(tmp_path / "weights.bin")
    assert "lie outside of its folder" in refused(external(folder, location))


@pytest.mark.skipif(free_memory() is None, reason="this system does not tell how much memory is free")
def test_a_model_larger_than_the_memory_is_refused(tmp_path: Path) -> None:
    free = free_memory()
    assert free is not None
    path = external(tmp_path, "weights.bin", 2 * free)
    with (tmp_path / "weights.bin").open("wb") as stream:
        stream.truncate(2 * free)  # takes no place on the disk
    assert "of memory are free" in refused(path)


def test_a_file_of_three_gigabytes_is_refused(tmp_path: Path) -> None:
    path = graphs.save(graphs.yolov8_raw(), tmp_path, CONTRACT)
    os.truncate(path, 3 * 10**9)
    assert "GB" in refused(path)


def test_an_input_that_does_not_fit_is_said_with_both_shapes(tmp_path: Path) -> None:
    grey = {**CONTRACT, "input": {"color": "GRAY"}}
    message = refused(graphs.save(graphs.yolov8_raw(), tmp_path, grey))
    assert "[1, 3, 64, 64]" in message
    assert "[1, 1, height, width]" in message
    turned = {**CONTRACT, "input": {"layout": "NHWC"}}
    assert "[1, height, width, 3]" in refused(graphs.save(graphs.yolov8_raw(), tmp_path, turned))
    sized = {**CONTRACT, "input": {"size": [96, 64]}}
    assert "96x64; the network's input is 64x64" in refused(graphs.save(graphs.yolov8_raw(), tmp_path, sized))
    halved = {**CONTRACT, "input": {"dtype": "float16"}}
    assert "float32; the contract says float16" in refused(graphs.save(graphs.yolov8_raw(), tmp_path, halved))


@pytest.mark.parametrize("kind", [kind for kind in schema()["properties"]["kind"]["enum"] if kind != "semantic"])
def test_an_output_that_does_not_fit_is_said_with_both_shapes(kind: str, tmp_path: Path) -> None:
    count = {"ssd": 2, "detr": 2, "yolo_seg": 2, "instance_masks": 4}.get(kind, 1)
    graph = graphs.Graph()
    mean = graph.node("ReduceMean", "images", axes=[1], keepdims=1)
    names = [graph.node("Identity", mean, name=f"output{number}") for number in range(count)]
    message = refused(graphs.save(graph.model(names), tmp_path, {**CONTRACT, "kind": kind}))
    assert "[1, 1, 64, 64]" in message
    assert "needed" in message


def test_too_few_outputs_and_unknown_names_are_said(tmp_path: Path) -> None:
    model = graphs.yolov8_raw()
    assert "has 1 outputs (output0)" in refused(graphs.save(model, tmp_path, {**CONTRACT, "kind": "ssd"}))
    named = {**CONTRACT, "output": {"names": ["boxes"]}}
    assert "no output 'boxes'; its outputs are output0" in refused(graphs.save(model, tmp_path, named))


def test_a_network_that_returns_nan_is_refused(tmp_path: Path) -> None:
    model = graphs.constant_output(float("nan"), [1, 6, 64])
    assert "'output' holds NaN" in refused(graphs.save(model, tmp_path, CONTRACT))


def test_a_network_that_marks_everything_is_refused(tmp_path: Path) -> None:
    model = graphs.constant_output(1.0, [1, 1, 64, 64])
    message = refused(graphs.save(model, tmp_path, {"kind": "semantic", "vehicle_ids": [1]}))
    assert "100% of an empty picture" in message


def test_a_class_outside_of_the_range_is_named(tmp_path: Path) -> None:
    path = graphs.save(graphs.yolov8_raw(), tmp_path, {**CONTRACT, "vehicle_ids": [1, 7]})
    message = refused(path)
    assert "vehicle_ids has 7" in message
    assert "from 0 to 1" in message


def test_unknown_keys_of_a_contract_are_named(tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_text(json.dumps({**CONTRACT, "input": {"colour": "RGB", "scale": 1}}))
    with pytest.raises(MaskError, match=r"c\.json: input has the unknown keys 'colour'; known are layout"):
        read_contract(path)


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"kind": "yolov3"}, "yolov3"),
        ({"vehicle_ids": []}, "vehicle_ids"),
        ({"vehicle_ids": [-1]}, "-1"),
        ({"input": {"std": [0, 1, 1]}}, "std"),
        ({"input": {"mean": [0, 0]}}, "2 numbers; needed are 1 or 3"),
        ({"input": {"scale": "1/255"}}, "1/255"),
        ({"output": {"score": 2}}, "score"),
    ],
)
def test_a_contract_that_makes_no_sense_is_refused(change: dict[str, Any], what: str, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_text(json.dumps({**CONTRACT, **change}))
    with pytest.raises(MaskError) as caught:
        read_contract(path)
    assert str(path) in str(caught.value)
    assert what in str(caught.value)


@pytest.mark.parametrize("content", [b"", b"{", b"\xff\xfe", b"[" * 100_000])
def test_what_is_no_json_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "c.json"
    path.write_bytes(content)
    with pytest.raises(MaskError, match="is no JSON"):
        read_contract(path)
    with pytest.raises(MaskError, match="does not exist; needed is a contract"):
        read_contract(tmp_path / "none.json")


def test_a_provider_that_is_not_there_is_said(tmp_path: Path) -> None:
    import onnxruntime

    path = graphs.save(graphs.yolov8_raw(), tmp_path, CONTRACT)
    names: dict[Provider, str] = {"dml": "DmlExecutionProvider", "coreml": "CoreMLExecutionProvider"}
    absent = next(key for key, name in names.items() if name not in onnxruntime.get_available_providers())
    message = refused(path, provider=absent)
    assert f"--mask-provider is {absent}" in message
    assert "cpu" in message


def test_the_schema_is_one_and_its_defaults_are_ours() -> None:
    from dataclasses import fields

    from jsonschema import Draft202012Validator

    from laci_stereo.mask.contract import InputSpec, OutputSpec

    Draft202012Validator.check_schema(schema())
    for name, spec in (("input", InputSpec()), ("output", OutputSpec())):
        told = schema()["properties"][name]["properties"]
        assert set(told) == {field.name for field in fields(spec)}
        for key, entry in told.items():
            if "default" in entry and key not in ("mean", "std"):
                own = getattr(spec, key)
                assert entry["default"] == (list(own) if isinstance(own, tuple) else own)
    assert np.all(np.array(InputSpec().mean) == 0)
