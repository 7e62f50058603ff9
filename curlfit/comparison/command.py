"""`curlfit compare`: many laws, one throw."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from curlfit.errors import InputError
from curlfit.options import settings as s
from curlfit.options.figures import FigureFiles
from curlfit.options.output import Output, Saved, progress_line
from curlfit.settings.choices import FLAGS, Comparing, Reading


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
    alone = data[0]
    if len(data) == 1 and is_friction_table(alone, reading.worksheet, reading.columns):
        from curlfit.friction_tables.command import fit_table

        return fit_table(alone, flags, output, "compare", reading)
    if len(data) == 1 and not rows_of_table(alone, reading):
        return _one_throw(alone, flags, reading, config, output)
    return _several(data, flags, reading, config, output)


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

    drawn, configured = output.drawn(), s.read_config(config)
    chosen = Comparing.of(configured, vars(flags))
    how = vars(Reading.of(configured, vars(reading)))
    items: list[Any] = []
    for file in data:
        items += (
            [load_friction_table(file)]
            if is_friction_table(file)
            else load_throws(file, **how)
        )
    single = len(data) == 1
    usual = (
        s.result_folder(data[0], "compare", reading)
        if single
        else Path("joint-compare")
    )
    return _compared(items, chosen, (claim_folder(output.out or usual), drawn), output)


def _one_throw(
    data: Path, flags: Comparing, reading: Reading, config: Path | None, output: Output
) -> Saved:
    """Compare laws on one track."""
    from curlfit.friction import LAWS, find_law
    from curlfit.inference.parameters import ParameterSet, options_of, require_known
    from curlfit.output.files import claim_folder
    from curlfit.throws.plausibility import require_plausible
    from curlfit.throws.throw import require_path

    drawn = output.drawn()
    job = s.prepare(data, config, reading, flags)
    throw, chosen, cut = job.throw, job.chosen, job.cut
    unusual = require_plausible(cut)
    laws = [find_law(name) for name in chosen.laws] or list(LAWS.values())
    options = {**chosen.by_parameter, "start": chosen.start}
    require_known(
        laws, {FLAGS.get(name, f"--{name}"): values for name, values in options.items()}
    )
    for law in laws:
        own = options_of(law, chosen.by_parameter)
        ParameterSet.for_throw(law, cut, swept=chosen.swept is not None, **own)
    require_path(cut)
    folder = claim_folder(output.out or s.result_folder(data, "compare", reading))
    return _compared(throw, chosen, (folder, drawn), output, unusual)


def _compared(
    data: Any,
    chosen: Comparing,
    saved: tuple[Path, FigureFiles],
    output: Output,
    remarks: Sequence[object] = (),
) -> Saved:
    """Compare laws on a throw, or on data sets, and write what was found."""
    from rich.progress import BarColumn, MofNCompleteColumn

    folder, drawn = saved
    drawn.draw_beside()
    compiles = "(a first run on a machine compiles each law)"
    columns = "Fitting {task.description}", BarColumn(), MofNCompleteColumn(), compiles
    with progress_line(output.console(), *columns) as show:
        from curlfit.comparison.compare import compare as compare_laws

        found = compare_laws(data, progress=show, **vars(chosen))
    return output.finish(found, folder, drawn, remarks=remarks)
