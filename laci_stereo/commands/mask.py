"""``laci-stereo mask``: what a vehicle mask detects, before it is used."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import click
import cv2
import numpy as np

from laci_stereo.commands.options import PATH, say_written, with_options
from laci_stereo.core.errors import ImageError, SettingError
from laci_stereo.core.frames import Raster
from laci_stereo.core.subsampling import spread
from laci_stereo.io.images import ImageFolder, read_image, write_picture
from laci_stereo.io.output import check_files, make_folder
from laci_stereo.mask.detect import NetworkFinder, Vehicle
from laci_stereo.mask.network import PROVIDERS, MaskOptions, Network, Provider
from laci_stereo.mask.picture import Cell, Crop
from laci_stereo.mask.stage import outlines
from laci_stereo.report.style import BLACK, YELLOW
from laci_stereo.start import INTERRUPTED
from laci_stereo.stereo.reader import EightBit
from laci_stereo.stereo.recording import LOOK_FRAMES

MASK_SHARE = 0.4
"""Opacity of a mask's colour in the picture."""


mask_options = with_options(
    click.option(
        "--mask-contract",
        "--contract",
        "contract",
        type=PATH,
        help="What the network expects and returns (JSON) [default: MODEL.contract.json beside it].",
    ),
    click.option(
        "--mask-provider",
        "provider",
        type=click.Choice(list(PROVIDERS)),
        default="cpu",
        show_default=True,
        help="What the mask's network runs on, where the installed onnxruntime offers it.",
    ),
)


def asked_mask(model: Path | None, contract: Path | None, provider: Provider, workers: int) -> MaskOptions | None:
    """Return the requested vehicle mask, if any.

    Raises
    ------
    SettingError
        If there is a contract, but no model.
    """
    if model is not None:
        return MaskOptions(model, contract, provider, workers)
    if contract is not None:
        raise SettingError(f"--mask-contract is {contract} without a mask; needed is --vehicle-mask MODEL.onnx")
    return None


@dataclass(frozen=True)
class Look:
    """The detections in an image, and how long the network took."""

    path: Path
    image: Raster
    vehicles: tuple[Vehicle, ...]
    seconds: float


@click.command()
@click.argument("model", type=PATH)
@click.argument("left", type=PATH)
@mask_options
@click.option("--out", type=PATH, default=Path("mask"), show_default=True, help="Folder for the pictures (JPEG).")
@click.option("--overwrite", is_flag=True, help="Replace pictures that are there already.")
@click.option("--every", type=click.IntRange(min=1), default=1, show_default=True, help="Take every N-th image only.")
def mask(
    model: Path, left: Path, contract: Path | None, provider: Provider, out: Path, overwrite: bool, every: int
) -> None:
    """Look what a detector or segmenter sees, before a run with --vehicle-mask.

    MODEL is an ONNX file, LEFT a folder of images. Writes pictures with the boxes or masks, and prints a table of
    what was found and how long it took.
    """
    files = ImageFolder.open(left).files[::every]
    targets = {path: out / f"{path.stem}.jpg" for path in files}
    network = Network(MaskOptions(model, contract, provider))
    make_folder(out)
    check_files(targets.values(), overwrite=overwrite)
    if network.assumed:
        click.echo(f"note: {network.assumed}", err=True)
    click.echo(f"{'image':<28}{'ms':>6}  {'vehicles':>8}  class, score, left top right bottom")
    looks = 0
    found = 0
    seconds: list[float] = []
    try:
        for look in looked_at(NetworkFinder(network, (Cell(0, 0, *network.size),)), files):
            write_picture(targets[look.path], drawn(look))
            click.echo(row(look))
            looks, found = looks + 1, found + bool(look.vehicles)
            seconds.append(look.seconds)
    except KeyboardInterrupt:
        if not looks:
            raise
        click.echo(f"interrupted; {looks} of {len(files)} pictures are in {out}", err=True)
        sys.exit(INTERRUPTED)
    if not looks:
        raise ImageError(f"{left}: none of {len(files)} images can be read")
    click.echo(f"Vehicles in {found} of {looks} images; {1000 * float(np.median(seconds)):.0f} ms each (median)")
    say_written(f"{out}: {looks} pictures")


def looked_at(finder: NetworkFinder, files: tuple[Path, ...]) -> Iterator[Look]:
    """Run a network on whole images; those that cannot be read are named and skipped."""
    eight_bit = EightBit()
    eight_bit.learn_from(spread(files, LOOK_FRAMES))
    for path in files:
        try:
            colour = eight_bit.colour(read_image(path))
        except ImageError as problem:
            click.echo(f"note: {problem}", err=True)
            continue
        start = time.perf_counter()
        vehicles = finder.find([Crop(0, 0, 0, colour)])[0]
        yield Look(path, colour, vehicles, time.perf_counter() - start)


def row(look: Look) -> str:
    """Return a line of the table."""
    each = [
        f"{vehicle.class_id} {vehicle.score:.2f} [{' '.join(f'{value:.0f}' for value in vehicle.box)}]"
        for vehicle in look.vehicles
    ]
    return f"{look.path.name:<28}{1000 * look.seconds:>6.0f}  {len(look.vehicles):>8}  {'; '.join(each)}"


def drawn(look: Look) -> Raster:
    """Return the image with the detections drawn into it."""
    picture: Raster = look.image.copy()
    for vehicle in look.vehicles:
        if vehicle.mask is not None:
            x, y = vehicle.corner
            height, width = vehicle.mask.shape
            part = picture[y : y + height, x : x + width]
            part[vehicle.mask] = (1 - MASK_SHARE) * part[vehicle.mask] + MASK_SHARE * np.array(YELLOW)
        for colour, thickness in ((BLACK, 4), (YELLOW, 2)):
            lines = [np.rint(outline).astype(np.int32) for outline in outlines(vehicle)]
            cv2.polylines(picture, lines, True, colour, thickness, cv2.LINE_AA)
            at = (int(vehicle.box[0]), max(int(vehicle.box[1]) - 6, 14))
            label = f"{vehicle.class_id}: {vehicle.score:.2f}"
            cv2.putText(picture, label, at, cv2.FONT_HERSHEY_SIMPLEX, 0.5, colour, thickness, cv2.LINE_AA)
    return picture
