"""`curlfit compare`: many laws, one throw."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from curlfit.errors import InputError
from curlfit.options import settings as s
from curlfit.options.figures import FigureFiles
from curlfit.options.output import Output, Saved, progress_line
from curlfit.settings.choices import Comparing, Reading, flag_of

if TYPE_CHECKING:
    from curlfit.comparison.candidates import Progress
    from curlfit.comparison.result import Comparison


def compare(
    *data: Path,
    flags: Comparing = Comparing(),
    reading: Reading = Reading(),
    config: s.Config = None,
    output: Output = Output(),
) -> Saved:
    """Fit many friction laws to one throw, or to several data sets at once,
    and rank them.

    Each law is fitted within its own bounds; one that fails with a coefficient at zero
    is fitted again with either sign allowed, which is shown and not ranked. Laws are
    ranked by BIC; with a robust `--loss`, by that of the corresponding noise
    distribution. If residuals are independent, the log evidence (dlnZ) and the expected
    log predictive density of leave-one-out (delpd, with the standard error of the
    difference) are given too. `--fix`, `--bound` and `--start` hold for the laws that
    have such a parameter.
    Several files are tracks, tables of throws by stopwatch and tables of friction
    against speed, of which one set of coefficients of each law must answer all.
    Writes `compare.json` and `compare.png`.

    Example: `curlfit compare data/jensen_shegelski_2004.csv --load both`

    Parameters
    ----------
    data
        Data as for `curlfit fit`; tables of friction against speed.
    """
    from curlfit.throws.friction_table import is_friction_table
    from curlfit.throws.load import rows_of_table

    if not data:
        raise InputError("compare: no file given; expected DATA")
    first_file, *other_files = data
    if other_files:
        return _several(data, flags, reading, config, output)
    if is_friction_table(first_file, reading.worksheet, reading.columns):
        from curlfit.friction_tables.command import fit_table

        return fit_table(first_file, flags, output, "compare", reading)
    if rows_of_table(first_file, reading):
        return _several(data, flags, reading, config, output)
    return _one_throw(first_file, flags, reading, config, output)


def _several(
    data: Sequence[Path],
    flags: Comparing,
    reading: Reading,
    config: Path | None,
    output: Output,
) -> Saved:
    """Compare laws on several data sets."""
    from curlfit.output.files import claim_folder
    from curlfit.throws.friction_table import is_friction_table, load_friction_table
    from curlfit.throws.load import load_throws

    figures = output.drawn()
    configured = s.read_config(config)
    chosen = Comparing.of(configured, vars(flags))
    reading = Reading.of(configured, vars(reading))
    data_sets: list[Any] = []
    for file in data:
        if is_friction_table(file, reading.worksheet, reading.columns):
            table = load_friction_table(
                file, reading.worksheet, reading.columns, reading.units
            )
            data_sets.append(table)
        else:
            data_sets.extend(load_throws(file, **vars(reading)))
    usual = Path("joint-compare")
    if len(data) == 1:
        usual = s.result_folder(data[0], "compare", reading)
    folder = claim_folder(output.out or usual)

    def compared(progress: Progress) -> Comparison:
        from curlfit.comparison.compare import compare as compare_laws

        return compare_laws(data_sets, progress=progress, **vars(chosen))

    return _shown(compared, folder, figures, output)


def _one_throw(
    data: Path, flags: Comparing, reading: Reading, config: Path | None, output: Output
) -> Saved:
    """Compare laws on one track."""
    from curlfit.comparison.requests import requests_of
    from curlfit.output.files import claim_folder

    figures = output.drawn()
    job = s.prepare(data, config, reading, flags)
    chosen = job.chosen
    flags_by_choice = {name: flag_of(name) for name, _ in chosen}
    requests = requests_of(job.throw, chosen, flags_by_choice)
    folder = claim_folder(output.out or s.result_folder(data, "compare", reading))

    def compared(progress: Progress) -> Comparison:
        from curlfit.comparison.compare import compare_requests

        return compare_requests(requests, chosen, progress)

    return _shown(compared, folder, figures, output, requests[0].findings)


def _shown(
    compared: Callable[[Progress], Comparison],
    folder: Path,
    figures: FigureFiles,
    output: Output,
    remarks: Sequence[object] = (),
) -> Saved:
    """Compare laws, with a line of progress, and write the comparison."""
    from rich.progress import BarColumn, MofNCompleteColumn

    figures.draw_beside()
    columns = (
        "Fitting {task.description}",
        BarColumn(),
        MofNCompleteColumn(),
        "(a first run on a machine compiles each law)",
    )
    with progress_line(output.console(), *columns) as show:
        comparison = compared(show)
    return output.finish(comparison, folder, figures, remarks=remarks)
