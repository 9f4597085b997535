"""A loaded network: its runtime session, execution provider, input size, and a test on an empty picture."""

from __future__ import annotations

import io
import logging
import re
from contextlib import redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, TypeAlias

from laci_stereo.core.frames import Raster
from laci_stereo.io.text_file import shortened
from laci_stereo.mask.contract import Contract, InputSpec, contract_beside, read_contract
from laci_stereo.mask.decode import Found, decode, in_roles
from laci_stereo.mask.errors import MaskError
from laci_stereo.mask.model_file import check_model
from laci_stereo.mask.picture import tensor
from laci_stereo.mask.recognise import Ports, Shape, recognise, shape_of

log = logging.getLogger(__name__)

Provider: TypeAlias = Literal["cpu", "cuda", "openvino", "coreml", "dml"]

PROVIDERS: dict[Provider, str] = {
    "cpu": "CPUExecutionProvider",
    "cuda": "CUDAExecutionProvider",
    "openvino": "OpenVINOExecutionProvider",
    "coreml": "CoreMLExecutionProvider",
    "dml": "DmlExecutionProvider",
}

FREE_SIZE = (640, 640)
"""Input size assumed if it is free and not given: most detectors are trained with this size."""

ALL_SHARE = 0.95
"""Fraction of a picture above which a marked vehicle leaves no background; in an empty picture there is none at all."""

SILENT = 4
"""Severity from which the runtime logs to standard error: fatal. Its exceptions are reported as one line instead."""

LONGEST = 400
"""Maximum length of the runtime's message, characters, because it can be verbose."""


@dataclass(frozen=True)
class MaskOptions:
    """The user's options of a vehicle mask.

    Attributes
    ----------
    model : Path
    contract : Path or None
        None: ``MODEL.contract.json`` beside the model, if it exists.
    provider : str
        Execution provider of the runtime.
    threads : int
        Number of threads; 0: the number of processors.
    """

    model: Path
    contract: Path | None = None
    provider: Provider = "cpu"
    threads: int = 0


class Network:
    """A vehicle detection or segmentation network, ready to run.

    Parameters
    ----------
    options : MaskOptions

    Attributes
    ----------
    contract : Contract
    assumed : str
        What was assumed in the absence of a contract, as text; empty with one.
    size : tuple of int
        Width and height of its input.

    Raises
    ------
    MaskError
        If it cannot be loaded, or its inputs and outputs do not fit its contract.
    """

    def __init__(self, options: MaskOptions) -> None:
        self.model = options.model
        self._session = _session(options)
        ports = _ports(self._session)
        path = options.contract or contract_beside(options.model)
        given = None if path is None else read_contract(path)
        shape = self._input_shape(ports, given)
        self.size = _size(self.model, shape, given.input if given is not None else None)
        self.assumed = ""
        if given is None:
            given, self.assumed = recognise(self.model, ports, self.size)
        self.contract = given
        self._check_input(shape)
        self._probe()

    def find(self, picture: Raster) -> tuple[Found, ...]:
        """Run the network on an input made by `laci_stereo.mask.picture.tensor`.

        Raises
        ------
        MaskError
            If it fails, or its outputs do not fit the contract.
        """
        try:
            values = self._session.run(None, {self._session.get_inputs()[0].name: picture})
        except Exception as problem:  # the runtime's exceptions have no common base class
            raise MaskError(
                f"{self.model}: fails on an input of the shape {list(picture.shape)}: {_said(problem)}"
            ) from problem
        names = [output.name for output in self._session.get_outputs()]
        return decode(in_roles(names, values, self.contract, str(self.model), self.size))

    def _input_shape(self, ports: Ports, contract: Contract | None) -> tuple[int | None, int | None]:
        """Return the width and height of the input; None where they are free."""
        shapes = ", ".join(f"{name} {list(shape)}" for name, shape in ports.inputs)
        fits = len(ports.inputs) == 1 and len(ports.inputs[0][1]) == 4 and ports.inputs[0][1][0] in (1, None)
        layout = "NCHW" if contract is None else contract.input.layout
        channels = 3 if contract is None else contract.input.channels
        needed = [1, channels, "height", "width"] if layout == "NCHW" else [1, "height", "width", channels]
        if fits:
            shape: Shape = ports.inputs[0][1]
            depth = shape[1 if layout == "NCHW" else 3]
            if depth in (channels, None):
                return (shape[3], shape[2]) if layout == "NCHW" else (shape[2], shape[1])
        raise MaskError(
            f"{self.model}: its inputs are {shapes}; needed for the contract's layout {layout} is one of the shape "
            f"[{', '.join(map(str, needed))}]"
        )

    def _check_input(self, shape: tuple[int | None, int | None]) -> None:
        wanted = self.contract.input.size
        if wanted is not None and any(mine not in (None, said) for mine, said in zip(shape, wanted, strict=True)):
            raise MaskError(
                f"{self.contract.source}: input.size is {wanted[0]}x{wanted[1]}; the network's input is "
                f"{shape[0]}x{shape[1]}"
            )
        types = {"tensor(float)": "float32", "tensor(float16)": "float16", "tensor(uint8)": "uint8"}
        input_type = self._session.get_inputs()[0].type
        if types.get(input_type) != self.contract.input.dtype:
            raise MaskError(
                f"{self.model}: its input is of type {types.get(input_type, input_type)}; the contract says "
                f"{self.contract.input.dtype}"
            )

    def _probe(self) -> None:
        """Run the network on an empty picture to check the shapes; reject one that marks all of it as a vehicle."""
        area = self.size[0] * self.size[1]
        for found in self.find(tensor([], self.size, self.contract.input)):
            box = float((found.box[2:] - found.box[:2]).prod())
            covered = box if found.mask is None else float(found.mask.sum())
            if covered > ALL_SHARE * area:
                raise MaskError(
                    f"{self.model}: marks {covered / area:.0%} of an empty picture as a vehicle; needed is a network "
                    f"that marks vehicles (is vehicle_ids {list(self.contract.vehicle_ids)} the background?)"
                )


def _session(options: MaskOptions) -> Any:
    # Imported here because loading the runtime takes longer than everything else before an argument error is reported.
    import onnxruntime

    name, offered = PROVIDERS[options.provider], onnxruntime.get_available_providers()
    if name not in offered:
        known = ", ".join(key for key, value in PROVIDERS.items() if value in offered)
        raise MaskError(f"--mask-provider is {options.provider}; this onnxruntime offers {known}")
    check_model(options.model)
    missed = _load_cuda(onnxruntime) if options.provider == "cuda" else ""
    asked = onnxruntime.SessionOptions()
    asked.log_severity_level = SILENT
    asked.intra_op_num_threads = options.threads
    asked.add_session_config_entry("session.intra_op.allow_spinning", "0")  # the matcher needs the processors
    try:
        session = onnxruntime.InferenceSession(str(options.model), asked, providers=[name])
    except Exception as problem:  # the runtime's exceptions have no common base class
        raise MaskError(f"{options.model}: cannot be loaded: {_said(problem)}") from problem
    if name not in session.get_providers():  # the runtime silently falls back on the processor
        why = f": {missed}" if missed else ""
        raise MaskError(f"--mask-provider is {options.provider}; onnxruntime cannot start it on this machine{why}")
    return session


def _load_cuda(onnxruntime: Any) -> str:
    """Load CUDA's libraries, including those from Python packages; return the first missing one, or an empty string.

    On its own, the runtime searches only the system's library paths.
    """
    printed = io.StringIO()
    if hasattr(onnxruntime, "preload_dlls"):  # available since 1.21
        with redirect_stdout(printed):
            onnxruntime.preload_dlls()
    return printed.getvalue().partition("\n")[0]


def _ports(session: Any) -> Ports:
    inputs, outputs = (
        tuple((port.name, shape_of(port.shape)) for port in ports)
        for ports in (session.get_inputs(), session.get_outputs())
    )
    return Ports(inputs, outputs, session.get_modelmeta().custom_metadata_map)


def _size(model: Path, shape: tuple[int | None, int | None], spec: InputSpec | None) -> tuple[int, int]:
    """Return the input size: the network's own where fixed, else the contract's, else the default."""
    said = FREE_SIZE if spec is None or spec.size is None else spec.size
    width, height = (other if own is None else own for own, other in zip(shape, said, strict=True))
    if min(width, height) < 1:
        raise MaskError(f"{model}: its input is {width}x{height}; needed are 1 pixel or more")
    return width, height


def _said(problem: Exception) -> str:
    """Return the runtime's message in one line, without references to its source code."""
    text = str(problem).strip() or type(problem).__name__
    for noise in (
        r"\[ONNXRuntimeError\] : \d+ : \w+ : ",
        r"Load model from .*? failed: ?",
        r"/\S+\.(?:h|cc|cpp):\d+ .*?\) ",
    ):
        text = re.sub(noise, "", text)
    return shortened(text, LONGEST)
