"""`curlfit fit`: a law fitted to one throw, or to several jointly."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from curlfit.errors import InputError, UnusableFitError
from curlfit.foreign import say
from curlfit.options import settings as s
from curlfit.options.output import COMPILES, Output, Saved, progress_line
from curlfit.output.display import document_of, figures_of
from curlfit.settings.choices import SEED, Choices, Fitting, Reading
from curlfit.settings.forms import NAMES, SWITCH, option, whole

if TYPE_CHECKING:
    from rich.console import Console

    from curlfit.friction import Law
    from curlfit.inference.fit.result import FitResult
    from curlfit.inference.model.request import Request
    from curlfit.inference.sampling.chain import Chain
    from curlfit.inference.together.result import JointResult


_BY_THROW = ("since", "until", "exclude", "stone", "sigma", "swept")
"""Settings that each throw keeps for itself, unless they are given for all."""
_MANY = 4  # throws from which on those without a path have no figure of their own
_EFFECTIVE = 4000  # size of the sample
_MOST_STEPS = 2000  # of the sampling
_UNUSABLE = 1  # exit status


@Parameter(name="*", group="Sampling")
@dataclass(frozen=True, kw_only=True)
class Sampling(Choices):
    """How the posterior is sampled.

    Attributes
    ----------
    no_sample : Least squares only; no posterior.
    effective : Effective sample size required for every parameter. [default: 4000]
    max_steps : Maximum number of sampling steps. [default: 2000]
    seed : Seed of the sampling. [default: 0]
    resume : Continue an earlier run in that folder, finished or interrupted: its
        least-squares result is reused (`--start` then has no effect) and its chain
        is continued.
    """

    no_sample: Annotated[bool, option(SWITCH)] = False
    effective: Annotated[int | None, option(whole(100), "N")] = None
    max_steps: Annotated[int | None, option(whole(40), "N")] = None
    seed: Annotated[int | None, option(SEED, "N")] = None
    resume: Annotated[bool, option(SWITCH)] = False

    def seed_of_several(self) -> int | None:
        """The seed for several throws that vary; None without sampling. Raises
        `InputError` for choices of the sampling of one throw."""
        unused = replace(self, no_sample=False, seed=None).words()
        if unused:
            raise InputError(f"{unused[0]}: expected it with one throw")
        return None if self.no_sample else self.seed or 0


@Parameter(name="*")
@dataclass(frozen=True, kw_only=True)
class Together(Choices):
    """What several throws have in common.

    Attributes
    ----------
    share : With several throws: coefficients that are equal in all of them. [default:
        all; from four throws on they vary about their mean]
    by : With several throws: labels by which they form groups that differ, such as
        `sheet`; the columns of the table, or of that of `--throws`.
    trend : With several throws: labels along which the ice changes, such as `start`
        (clock times or numbers).
    trend_by : With `--by` and `--trend`: labels, such as `sheet`, whose groups change
        each at its own rate. [default: all change alike]
    """

    share: Annotated[Sequence[str], option(NAMES, "all|NAME,...")] = ()
    by: Annotated[Sequence[str], option(NAMES, "LABEL,...")] = ()
    trend: Annotated[Sequence[str], option(NAMES, "LABEL,...")] = ()
    trend_by: Annotated[Sequence[str], option(NAMES, "LABEL,...")] = ()


def fit(
    *data: Path,
    flags: Fitting = Fitting(),
    together: Together = Together(),
    reading: Reading = Reading(),
    config: s.Config = None,
    sampling: Sampling = Sampling(),
    output: Output = Output(),
) -> Saved:
    """Fit a friction law to a throw, or to several jointly, and show what the
    path determines.

    Writes `fit.json`, `fit.png` and, unless `--no-sample`, `chain.h5` and `corner.png`;
    for several throws `joint.json`, `joint.png` and a folder for each, and where they
    vary `chain.h5` and `corner.png` of their mean and spreads.
    Rows of a stopwatch table that the others contradict are left out and named first;
    `--keep` uses them.
    Ctrl-C during sampling keeps the chain so far; `--resume` continues it
    (of one throw).

    Example: `curlfit fit data/jensen_shegelski_2004.csv --stone rho=0.1025`

    Parameters
    ----------
    data
        Table with a header: t, x, y and if possible phi (s, m, m, rad; other units as
        y_ft, angle_deg ...). Leading lines `# key = value` are its defaults. Several
        files, or those of a folder, are fitted jointly; of a table of `curlfit batch`,
        the throws that it contains. `-` is standard input.
    """
    from curlfit.batch.table import is_table_of_batch
    from curlfit.throws.friction_table import is_friction_table

    files = _files_of(data, reading)
    if len(files) == 1 and is_friction_table(
        files[0], reading.worksheet, reading.columns
    ):
        from curlfit.friction_tables.command import fit_table

        return fit_table(files[0], flags, output, "fit", reading, sampling)
    output.drawn()  # refuses formats before the files are read
    if is_table_of_batch(files[0]):
        unused = [*replace(flags, law=None).words(), *reading.words()]
        if unused:
            raise InputError(
                f"{unused[0]}: the throws of {files[0]} are fitted already; "
                "expected it in the batch"
            )
        seed = sampling.seed_of_several()
        return _fit_season(files, flags.law, together, seed, output)
    if sampling.resume and sampling.no_sample:
        raise InputError(
            "--resume continues sampling, and --no-sample skips it; give one of them"
        )
    jobs = s.prepare_all(files, config, reading, flags)
    if len(jobs) > 1:
        usual = Path("joint-fit")
        if len(data) == 1:
            usual = s.result_folder(data[0].resolve(), "fit", reading)
        return _fit_jointly(jobs, together, sampling.seed_of_several(), output, usual)
    unused = together.words()
    if unused:
        flag = unused[0].partition("=")[0]
        raise InputError(f"{flag} needs several throws")
    (job,) = jobs.values()
    return _fit_one(job, s.result_folder(files[0], "fit", reading), sampling, output)


def _files_of(data: Sequence[Path], reading: Reading) -> Sequence[Path]:
    """The files that are named, and those of folders. Raises `InputError` if there are
    none."""
    if not data:
        raise InputError("fit: no file given; expected DATA")
    if not any(file.is_dir() for file in data):
        return data
    from curlfit.throws.load import found_files

    notes = [] if reading.throws is None else [Path(reading.throws)]
    return found_files(list(map(str, data)), besides=notes)


def _fit_one(
    job: s.ConfiguredThrow[Fitting], usual: Path, sampling: Sampling, output: Output
) -> Saved:
    """Fit one throw and print the report; write `fit.json`, the chain and figures to a
    folder, the usual one if the output names none."""
    from curlfit.options.figures import remove_figure
    from curlfit.output.files import claim_folder

    request = job.request  # every choice is checked here, before JAX is loaded
    folder = output.out or usual
    seed = job.seed if sampling.seed is None else sampling.seed
    saved = _saved_fit(folder, request) if sampling.resume else None
    if saved is not None:
        seed = _seed_of_chain(folder, saved, seed)
    folder = claim_folder(folder)
    record = folder / "fit.json"
    chain_file = folder / "chain.h5"
    drawn = output.drawn()
    console = output.console()
    if sampling.resume and saved is None:
        console.print(
            f"Nothing to resume in {folder}; this is a first run.", soft_wrap=True
        )
    drawn.draw_beside()
    if saved is None:
        with output.status(f"Fitting {COMPILES}"):
            from curlfit.inference.fit.fit import fit_request
            from curlfit.inference.fit.throw_stack import first_problem

            if not sampling.no_sample:
                from curlfit.inference.sampling.sampler import prepare_sampling

                # its program is compiled beside those of the fit
                prepare_sampling(*first_problem(request))
            result = fit_request(request)
    else:
        result = saved.with_derived(request.derive)
    if not sampling.no_sample:
        # so it is kept on disk meanwhile
        result = replace(result, posterior=None, sampling="unfinished")
    result.save(record)
    if saved is None:
        remove_figure(folder, "corner")  # of an earlier fit
        chain_file.unlink(missing_ok=True)
    drawn.replace(folder, ["fit"], partial(figures_of, result))
    chain: Chain | None = None
    if not sampling.no_sample:
        try:
            result, chain = _sample(
                console,
                result,
                seed=seed or 0,
                effective=sampling.effective or _EFFECTIVE,
                most_steps=sampling.max_steps or _MOST_STEPS,
                checkpoint=chain_file,
                resume=saved is not None,
            )
        except KeyboardInterrupt:
            drawn.written()  # waits for the figure of the fit
            raise
        except UnusableFitError as error:
            if not result.converged:
                raise
            # the fit holds, though its posterior has no end or no beginning
            say(f"curlfit: warning: no posterior: {error}", error=True)
            result = replace(result, sampling="none")
        result.save(record)
    written = [record]
    if chain is not None:
        written.append(chain_file)
        from curlfit.reports.corner import corner_of

        drawn.replace(folder, ["corner"], partial(corner_of, result, chain))
    console.print(document_of(result))
    verb_result = output.written(folder, [*written, *drawn.written()], console)
    posterior = result.posterior
    if result.converged and posterior is not None and not posterior.converged:
        say(f"curlfit: warning: posterior {posterior.status}", error=True)
    return _with_status(verb_result, result)


def _saved_fit(folder: Path, request: Request) -> FitResult | None:
    """The fit that was saved in a folder, if any, to be resumed. Raises `InputError` if
    it is of another problem."""
    if not (folder / "fit.json").exists():
        return None
    from curlfit.inference.fit.result import load_fit
    from curlfit.inference.sampling import chain

    saved = load_fit(folder)
    subject = chain.subject_of_fit(
        request.throw,
        request.law,
        request.load.value,
        request.stone,
        request.parameters,
        request.loss.name,
        request.noise.kind,
    )
    chain.require_same(chain.subject_of_saved(saved), subject, folder / "fit.json")
    return saved


def _seed_of_chain(folder: Path, saved: FitResult, seed: int | None) -> int | None:
    """The seed with which the chain of a saved fit goes on: that of the chain, if there
    is one, unless another is given. Raises `InputError` if the chain is of another
    problem or seed."""
    from curlfit.inference.sampling import chain

    file = folder / "chain.h5"
    if not file.exists():
        return seed
    stored = chain.load_chain(file)
    if seed is None:
        seed = stored.seed
    chain.require_same(stored.subject, chain.subject_of(saved, seed), file)
    return seed


def _with_status(verb_result: Saved, result: FitResult | JointResult) -> Saved:
    """The result of the verb, with an exit status; an unusable fit is reported on
    stderr."""
    if result.converged:
        return verb_result
    say(f"curlfit: the fit is not usable: {result.status}", error=True)
    return verb_result._replace(status=_UNUSABLE)


def _sample(
    console: Console,
    result: FitResult,
    *,
    seed: int,
    effective: int,
    most_steps: int,
    checkpoint: Path,
    resume: bool,
) -> tuple[FitResult, Chain]:
    """Sample the posterior of a fit with a line of progress on the terminal; the chain
    is kept in the file `checkpoint`."""
    from rich.progress import BarColumn, TimeRemainingColumn

    from curlfit.inference.sampling.sampler import sample

    columns = (
        "Sampling the posterior",
        BarColumn(),
        "{task.completed:.0f}/{task.total} effective samples",
        TimeRemainingColumn(),
        "{task.description}",
    )
    with progress_line(console, *columns) as show:
        show("compiling", 0, effective)

        def show_state(samples: float, steps: int, r_hat: float) -> None:
            show(f"{steps} steps, R-hat {r_hat:.3f}", min(samples, effective))

        # R-hat takes time: it is not computed where nobody sees it
        hidden = console.quiet or not console.is_terminal
        return sample(
            result,
            seed=seed,
            effective=effective,
            most_steps=most_steps,
            checkpoint=checkpoint,
            resume=resume,
            progress=None if hidden else show_state,
        )


def _fit_jointly(
    job_by_name: Mapping[str, s.ConfiguredThrow[Fitting]],
    together: Together,
    seed: int | None,
    output: Output,
    usual: Path,
) -> Saved:
    """Fit several throws, by the names of their folders, jointly and print the report;
    write `joint.json`, figures, single fits."""
    from curlfit.friction import find_law
    from curlfit.inference.together.request import JointRequest
    from curlfit.output.files import claim_folder

    drawn = output.drawn()
    jobs = list(job_by_name.values())
    chosen = jobs[0].chosen
    _require_alike(jobs)
    share: Sequence[str] | str | None = together.share or None
    if share == ("all",):
        share = "all"
    else:
        _require_coefficients(together.share, find_law(chosen.law))
    throws = []
    for job in jobs:
        of_throw = {key: getattr(job.chosen, key) for key in _BY_THROW}
        throws.append(job.throw.with_defaults(**of_throw))
    of_all = {key: value for key, value in chosen if key not in _BY_THROW}
    request = JointRequest.of(
        throws,
        of_all,
        share=share,
        by=together.by,
        trend=together.trend,
        trend_by=together.trend_by,
    )
    folder = claim_folder(output.out or usual)
    drawn.draw_beside()

    columns = (f"Fitting {len(jobs)} throws {COMPILES}", "{task.description}")
    with progress_line(output.console(), *columns) as show:
        from curlfit.inference.together.fit import fit_joint_request

        result = fit_joint_request(
            request,
            seed=seed,
            progress=lambda step, chi_squared: show(
                f"step {step}, chi squared {chi_squared:.6g}"
            ),
        )
    for name, fit in zip(job_by_name, result.throws, strict=True):
        folder_of_throw = claim_folder(folder / name)
        fit.save(folder_of_throw / "fit.json")
        if fit.rms or len(jobs) < _MANY:  # times alone are seen in one figure
            drawn.replace(folder_of_throw, ["fit"], partial(figures_of, fit))
    names = list(job_by_name)
    if len(names) > 3:
        names = [names[0], "...", names[-1]]
    more = f", and in {folder}/ a folder for each throw: {', '.join(names)}"
    return _with_status(output.finish(result, folder, drawn, more=more), result)


def _require_coefficients(names: Sequence[str], law: type[Law]) -> None:
    """Raise `InputError` for names of `--share` that are no coefficients of the law."""
    coefficients = [coefficient.name for coefficient in law.coefficients()]
    for name in names:
        if name not in coefficients:
            raise InputError(
                f"--share {name}: law {law.name} has no such coefficient; "
                f"it has {', '.join(coefficients)}"
            )


def _require_alike(jobs: Sequence[s.ConfiguredThrow[Fitting]]) -> None:
    """Raise `InputError` for throws whose files state different laws or loads."""
    first = jobs[0]
    for job in jobs[1:]:
        for key in ("law", "load"):
            value = getattr(job.chosen, key)
            expected = getattr(first.chosen, key)
            if value != expected:
                raise InputError(
                    f"{job.throw.name}: {key}: {value}, where {first.throw.name} has "
                    f"{expected}; give one with --{key}"
                )


def _fit_season(
    tables: Sequence[Path],
    law: str | None,
    together: Together,
    seed: int | None,
    output: Output,
) -> Saved:
    """Fit the mean of throws that `curlfit batch` fitted one by one; write `joint.json`
    and its figure."""
    from curlfit.output.files import claim_folder

    table, *other_files = tables
    if other_files:
        raise InputError(
            f"{table}: a table of many throws; expected no other file beside it"
        )
    drawn = output.drawn()
    with output.status(f"Fitting the throws of {table} {COMPILES}"):
        from curlfit.batch.season import fit_season

        result = fit_season(
            table,
            law,
            by=together.by,
            trend=together.trend,
            trend_by=together.trend_by,
            seed=seed,
        )
    folder = claim_folder(output.out or Path(f"{table.stem}-fit"))
    drawn.draw_beside()
    return _with_status(output.finish(result, folder, drawn), result)
