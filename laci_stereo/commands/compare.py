"""``laci-stereo compare``: the repetition error of results of one sensor."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from laci_stereo.commands.options import PATH, say_written
from laci_stereo.commands.program import NEGATIVE
from laci_stereo.compare import SHARED, Comparison, chance, compare, to_csv, to_summary, to_table
from laci_stereo.io.output import check_files, write_file
from laci_stereo.report.page.compare import Pair, Row, write_compare_page


@click.command(name="compare")
@click.argument("results", nargs=-1, required=True, type=PATH, metavar="RESULT RESULT...")
@click.option("--csv", "csv_file", type=PATH, help="File for the table.")
@click.option("--page", "page_file", type=PATH, help="File for the table as a page (HTML).")
@click.option("--renamed", is_flag=True, help="It is one sensor, though the results' names for it differ.")
@click.option("--overwrite", is_flag=True, help="Replace files that are there already.")
def compare_command(
    results: tuple[Path, ...], csv_file: Path | None, page_file: Path | None, renamed: bool, overwrite: bool
) -> None:
    """Compare results of one sensor: by how much they differ, and by how much they claim to.

    RESULT are result folders or their calibration.json, of different drives or settings. Results in
    different UTM zones are compared in that of the first.

    Exit codes: 0 they agree within what they claim, or one was imported and claims nothing; 1 some contradict each
    other; 2 the input cannot be read or makes no sense.
    """
    check_files([csv_file, page_file], overwrite=overwrite)
    comparisons = compare(results, renamed=renamed)
    click.echo("\n\n".join(map(to_table, comparisons)))
    for words in filter(None, (to_summary(comparisons), SHARED)):
        click.echo(f"\n{words}")
    if csv_file is not None:
        write_file(csv_file, to_csv(comparisons).encode())
    if page_file is not None:
        write_file(page_file, write_compare_page([_pair(each) for each in comparisons], SHARED).encode())
    say_written(csv_file, page_file)
    if any(each.outcome == "contradict" for each in comparisons):
        sys.exit(NEGATIVE)


def _pair(comparison: Comparison) -> Pair:
    rows = [Row(each.name, each.value, each.sigma, each.unit) for each in comparison.differences]
    return Pair(comparison.first, comparison.second, tuple(rows), comparison.outcome, chance(comparison))
