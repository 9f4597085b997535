"""``laci-stereo import``: another tool's transform as a result that can be checked and compared."""

from __future__ import annotations

from pathlib import Path

import click

from laci_stereo.commands.options import PATH, say_written
from laci_stereo.core.errors import SettingError
from laci_stereo.io.output import RESULT_FILE, check_output, result_folder
from laci_stereo.io.result.calibration_file import to_text
from laci_stereo.io.result.imported import Direction, ImportOptions, import_pose, imported_document
from laci_stereo.io.result.written_pose import KINDS
from laci_stereo.job import sha256


@click.command(name="import")
@click.argument("file", type=PATH)
@click.option("--from", "form", type=click.Choice(KINDS), help="How FILE is written [default: by its content].")
@click.option("--entry", help="Which of several transforms in FILE.")
@click.option("--kind", type=click.Choice(["stereo", "lidar"]), help="Of the sensor [default: as FILE says].")
@click.option("--crs", help="UTM zone of the map, as EPSG:32632 [default: as FILE says].")
@click.option(
    "--origin",
    metavar="E,N[,Z]",
    help="UTM coordinates of the map's origin, and the ground's z in it [default: as FILE says, else 0,0,0].",
)
@click.option(
    "--direction",
    type=click.Choice(["sensor-to-map", "map-to-sensor"]),
    help="Which way the transform leads [default: as FILE says, else sensor-to-map if only that is possible].",
)
@click.option(
    "--centre",
    metavar="E,N",
    help="UTM coordinates where the transform, being rigid, is true to the grid's scale [default: the sensor's].",
)
@click.option("--rectified", is_flag=True, help="It is of a camera whose images are rectified already.")
@click.option("--name", help="What you call the sensor [default: as FILE says, else FILE's name].")
@click.option("--out", type=PATH, default=Path("imported"), show_default=True, help="Folder for the result.")
@click.option("--overwrite", is_flag=True, help="Replace a result that is there already.")
def import_command(
    file: Path,
    form: str | None,
    entry: str | None,
    kind: str | None,
    crs: str | None,
    origin: str | None,
    direction: Direction | None,
    centre: str | None,
    rectified: bool,
    name: str | None,
    out: Path,
    overwrite: bool,
) -> None:
    """Take over a calibration that another tool made, to check, compare and export it.

    FILE holds a 4 x 4 matrix as text, or YAML, JSON or XML with a matrix, or with a translation and a rotation (matrix,
    quaternion, rotation vector, or roll, pitch and yaw), or is an export of this tool; of DAIR-V2X's cameras
    it is the folder with both files. How good it is nobody knows: compare tells by how much it differs, not whether
    that is too much, and check holds it against the map alone.
    """
    check_output(out, overwrite=overwrite)
    east_north = _numbers("--centre", centre, (2,))
    options = ImportOptions(
        kind=kind,
        crs=crs,
        origin=_numbers("--origin", origin, (2, 3)),
        direction=direction,
        centre=None if east_north is None else (east_north[0], east_north[1]),
        rectified=rectified,
        name=name,
        entry=entry,
        form=form,
    )
    imported = import_pose(file, options)
    document = imported_document(imported, {str(file): sha256(file)}, vars(options))
    with result_folder(out, overwrite=overwrite) as folder:
        (folder / RESULT_FILE).write_text(to_text(document), encoding="utf-8")
    for note in imported.notes:
        click.echo(f"note: {note}", err=True)
    world = imported.siting.world
    east, north = world.to_utm(imported.siting.T_world_sensor[None, :2, 3])[0]
    angles = document["euler_deg"]
    click.echo(f"{'Sensor':<11}{imported.siting.name} ({imported.siting.kind})")
    click.echo(f"{'Position':<11}{east:.2f} m E, {north:.2f} m N ({world.crs}), {document['height_m']:.2f} m high")
    click.echo(
        f"{'Looks':<11}{angles['yaw']:.2f} deg counter-clockwise from grid east, {angles['down']:.2f} deg down, rolled "
        f"{angles['roll']:.2f} deg clockwise"
    )
    say_written(out / RESULT_FILE)


def _numbers(option: str, text: str | None, counts: tuple[int, ...]) -> tuple[float, ...] | None:
    if text is None:
        return None
    try:
        values = tuple(float(word) for word in text.split(","))
    except ValueError:
        values = ()
    if len(values) not in counts or not all(abs(value) < 1e8 for value in values):
        raise SettingError(f"{option} is {text!r}; needed are {' or '.join(map(str, counts))} numbers in metres, E,N")
    return values
