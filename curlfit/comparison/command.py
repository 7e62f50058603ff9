"""`curlfit compare`: many laws, one throw."""

from __future__ import annotations

from pathlib import Path

from curlfit.options import settings as s
from curlfit.options.output import Output, Saved, progress_line
from curlfit.settings.choices import FLAGS, Comparing, Reading


def compare(
    data: Path,
    /,
    *,
    flags: Comparing = Comparing(),
    reading: Reading = Reading(),
    config: s.Config = None,
    output: Output = Output(),
) -> Saved:
    """Fit many friction laws to one throw, under one or several noise models, and rank them.

    Each law is fitted within its own bounds; one that fails with a coefficient at zero is fitted
    again with either sign allowed, which is shown and not ranked. Laws are ranked by BIC; with a
    robust `--loss`, by that of the corresponding noise distribution. If residuals are independent,
    the log evidence (dlnZ) and the expected log predictive density of leave-one-out (delpd, with
    the standard error of the difference) are given too. `--fix`, `--bound` and `--start` hold
    for the laws that have such a parameter.
    Writes `compare.json` and `compare.png`.

    Example: `curlfit compare data/jensen_shegelski_2004.csv --load both`

    Parameters
    ----------
    data
        Data as for `curlfit fit`.
    """
    from curlfit.friction_tables.table import is_friction_table

    if is_friction_table(data):
        from curlfit.friction_tables.command import fit_table

        return fit_table(data, flags, output, "compare", reading)
    from curlfit.friction import LAWS, find_law
    from curlfit.inference.parameters import ParameterSet, options_of, require_known
    from curlfit.output.files import prepare_folder
    from curlfit.throws.plausibility import require_plausible
    from curlfit.throws.throw import require_path

    drawn = output.drawn()
    job = s.prepare(data, config, reading, flags)
    throw, chosen, cut = job.throw, job.chosen, job.cut
    unusual = require_plausible(cut)
    laws = [find_law(name) for name in chosen.laws] or list(LAWS.values())
    options = {**chosen.by_parameter, "start": chosen.start}
    require_known(laws, {FLAGS.get(name, f"--{name}"): values for name, values in options.items()})
    for law in laws:
        own = options_of(law, chosen.by_parameter)
        ParameterSet.for_throw(law, cut, swept=chosen.swept is not None, **own)
    require_path(cut)
    folder = prepare_folder(output.out or s.result_folder(data, "compare", reading))

    from rich.progress import BarColumn, MofNCompleteColumn

    drawn.draw_beside()
    compiles = "(a first run on a machine compiles each law)"
    columns = "Fitting {task.description}", BarColumn(), MofNCompleteColumn(), compiles
    with progress_line(output.console(), *columns) as show:
        from curlfit.comparison.compare import compare as compare_laws

        found = compare_laws(throw, progress=show, **vars(chosen))
    return output.finish(found, folder, drawn, remarks=unusual)
