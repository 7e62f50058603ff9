"""A posterior sample, its file `chain.h5`, and the state needed to resume sampling."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from importlib.metadata import version as version_of
from io import BytesIO
from os import PathLike
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from curlfit.errors import DataError, InputError
from curlfit.friction import LAWS, Law
from curlfit.inference.fit.result import FitResult
from curlfit.inference.identifiability import with_combinations
from curlfit.inference.parameters import ParameterSet
from curlfit.numerics.arrays import Floats
from curlfit.output.console import PlainTable
from curlfit.output.display import Displayed
from curlfit.output.document import Document, Section
from curlfit.output.files import atomic_write
from curlfit.output.frames import frame, optional
from curlfit.output.text import from_to
from curlfit.records import structured
from curlfit.stone import Stone
from curlfit.throws.throw import Throw
from curlfit.version import __version__

_COMPRESSED = 200  # times as large as in its file, more than a chain can be
_SHOWN = 4  # parameters in a line
_LEVELS = (0.025, 0.16, 0.84, 0.975)
_DIGEST = "#"  # first character of a digest of numbers too many to be shown


@dataclass(frozen=True, eq=False, repr=False)
class Chain(Displayed):
    """A posterior sample.

    Attributes
    ----------
    names : of the parameters, fixed ones included.
    values : shape (steps, walkers, parameters). log_posterior : shape (steps, walkers).
    accepted : number of accepted proposals by walker. discarded : number of initial steps left out.
    ensembles : number of ensembles of equally many walkers. seed : of the run.
    subject : what was sampled, see `subject_of`.
    random_state : of numpy's `RandomState` after the last step, for resuming; None where unknown.
    mostly_ridge : whether most proposals are made along the ridge.
    fit : the one that was sampled; None where the chain was read from a file.

    Examples
    --------
    >>> chain
    Chain, ... samples: 4 ensembles, 128 walkers, ... steps, of which the first ... are left out
    68 %: mu1_xi ...
    >>> chain.of({"mu1_eta": 1.0, "mu2_eta": 1.0}).mean().round(4)
    np.float64(0.0176)
    >>> chain.to_frame().index.names
    FrozenList(['ensemble', 'walker', 'step'])
    """

    names: tuple[str, ...]
    values: Floats
    log_posterior: Floats
    accepted: NDArray[np.int64]
    discarded: int
    ensembles: int
    seed: int
    subject: dict[str, str] = field(default_factory=dict)
    random_state: tuple[Any, ...] | None = None
    mostly_ridge: bool = True
    fit: FitResult | None = field(default=None, compare=False)

    @property
    def flat(self) -> Floats:
        """The kept samples, shape (samples, parameters)."""
        return self.values[self.discarded :].reshape(-1, len(self.names))

    @property
    def acceptance(self) -> float:
        """Fraction of proposals accepted."""
        return float(self.accepted.mean() / max(len(self.values) - 1, 1))

    def of(self, weights: dict[str, float]) -> Floats:
        """Samples of a combination of parameters."""
        return cast(
            Floats,
            sum(weight * self.flat[:, self.names.index(name)] for name, weight in weights.items()),
        )

    @property
    def kept(self) -> Floats:
        """The kept samples by ensemble, shape (ensembles, walkers, steps, parameters)."""
        return self._by_ensemble(self.values)

    def _by_ensemble(self, series: Floats) -> Floats:
        _, walkers, *rest = series.shape
        kept = series[self.discarded :]
        split = kept.reshape(len(kept), self.ensembles, walkers // self.ensembles, *rest)
        return np.moveaxis(split, 0, 2)

    def _document(self) -> Document:
        steps, walkers, _ = self.values.shape
        rows = []
        for name, samples in zip(self.names, self.flat.T, strict=True):
            if len(samples) and np.ptp(samples) > 0:
                lowest, low, high, highest = np.quantile(samples, _LEVELS).tolist()
                outer = from_to(lowest, highest, (high - low) / 3)
                rows.append({"parameter": name, ">68 %": from_to(low, high), ">95 %": outer})
        shown = ", ".join(f"{row['parameter']} {row['>68 %']}" for row in rows[:_SHOWN])
        return Document(
            finding=f"{len(self.flat)} samples",
            subject=f"{self.ensembles} ensembles, {walkers} walkers, {steps} steps, of which the "
            f"first {self.discarded} are left out",
            lines=[f"68 %: {shown}{' ...' if len(rows) > _SHOWN else ''}"],
            sections=[Section("quantiles", "Quantiles", [PlainTable(rows)])],
        )

    def to_frame(self) -> Any:
        """The kept samples as a pandas DataFrame: a column for each parameter, for each determined
        combination of the fit (where the chain has one), and `log_posterior`; the index is
        (ensemble, walker, step).

        Raises
        ------
        InputError : pandas is not installed.
        """
        samples = self.kept
        combinations = () if self.fit is None else self.fit.combinations
        columns = with_combinations(self.names, samples.reshape(-1, len(self.names)), combinations)
        columns["log_posterior"] = self._by_ensemble(self.log_posterior).ravel()
        names = ("ensemble", "walker", "step")
        index = optional("pandas", "notebook").MultiIndex.from_product(
            (range(size) for size in samples.shape[:3]), names=names
        )
        return frame(columns, index)

    def with_fit(self, fit: FitResult) -> Chain:
        """The chain, read from a file, with the fit that was sampled.

        Raises
        ------
        InputError : the chain is of another fit.
        """
        now = subject_of(fit, self.seed) | {"parameters": ", ".join(fit.parameters)}
        own = self.subject | {"parameters": ", ".join(self.names)}
        for name, value in now.items():
            if not name.startswith("version") and own.get(name) != value:
                raise InputError(
                    f"the chain is of another fit: not the same {name}; sample this one again"
                )
        return replace(self, fit=fit)

    def to_arviz(self, fit: FitResult | None = None, *, draws: int = 4000, seed: int = 0) -> Any:
        """The kept samples for ArviZ, one chain per ensemble: its `InferenceData` where ArviZ is
        0.x, xarray's `DataTree` where it is 1.x.

        Groups: posterior (free parameters and determined combinations), posterior_predictive and
        log_likelihood (by channel; where noise is correlated, of each value given all others),
        log_prior (by parameter, up to a constant: 0 where flat, so that `arviz.psense` needs a fit
        with priors), sample_stats (`lp`, up to a constant),
        observed_data, constant_data (`t`, `sigma_x` ...).
        The draws of a chain are those of one walker after another, labelled by the coordinates
        `walker` and `step` of `draw`. A channel with gaps has its own dimension, such as `time_x`.
        ArviZ takes one channel at a time, as in `arviz.loo(data, var_name="x")`; the elpd of all
        is the sum.

        Parameters
        ----------
        fit : the one that was sampled; needed where the chain was read from a file.
        draws : approximate number over all chains; the steps are thinned evenly.
        seed : of the noise of posterior_predictive.

        Raises
        ------
        InputError : ArviZ is not installed, there is no fit, or the chain is of another fit.
        """
        chain = self if fit is None else self.with_fit(fit)
        if chain.fit is None:
            raise InputError(
                "a chain that was read from a file does not hold the data; expected "
                "chain.to_arviz(fit), with the fit of the same folder"
            )
        from curlfit.inference.mcmc.arviz_export import inference_data

        lp = self._by_ensemble(self.log_posterior)
        return inference_data(chain.fit, self.kept, lp, draws=draws, seed=seed)

    def save(self, file: str | PathLike[str], *, compressed: bool = True) -> None:
        """Write `chain.h5` atomically: a group for each ensemble, which emcee's `HDFBackend` opens,
        and curlfit's own attributes. Without compression it takes a tenth of the time and twice the
        space."""
        import h5py

        # Made in memory: HDF5 does not recover from a full disk.
        image = BytesIO()
        with h5py.File(image, "w") as out:
            self._write(out, {"compression": "gzip", "shuffle": True} if compressed else {})
        atomic_write(Path(file), image.getvalue())

    def _write(self, out: Any, how: dict[str, Any]) -> None:
        out.attrs.update(
            curlfit=__version__,
            names=list(self.names),
            discarded=self.discarded,
            seed=self.seed,
            subject=json.dumps(self.subject),
            mostly_ridge=self.mostly_ridge,
        )
        series = self.values, self.log_posterior, self.accepted[None]
        split = [np.split(each, self.ensembles, axis=1) for each in series]
        for number, (values, log_posterior, accepted) in enumerate(zip(*split, strict=True)):
            group = out.create_group(f"ensemble-{number}")
            steps, walkers, dimension = values.shape
            group.attrs.update(
                version=version_of("emcee"), iteration=steps, nwalkers=walkers, ndim=dimension,
                has_blobs=False,
            )  # fmt: skip
            group.create_dataset("chain", data=values, **how)
            group.create_dataset("log_prob", data=log_posterior)
            group.create_dataset("accepted", data=accepted[0])
            for place, item in enumerate(self.random_state or ()):
                group.attrs[f"random_state_{place}"] = item


def load_chain(file: str | PathLike[str], fit: FitResult | None = None) -> Chain:
    """Read a `chain.h5`.

    Parameters
    ----------
    fit : the one that was sampled, if the chain is to belong to it.

    Raises
    ------
    DataError : the file is missing, not valid or of an earlier version, or the chain is of another
        fit.

    Examples
    --------
    >>> chain.save("chain.h5")
    >>> curlfit.load_chain("chain.h5", fit).names == chain.names
    True
    """
    path = Path(file)
    if not path.is_file():
        raise DataError("no such file", file=path)
    import h5py

    chain = None
    try:
        with h5py.File(path, "r") as stored:
            if "mcmc" not in stored:
                chain = _read_chain(stored)
    except (
        OSError, LookupError, ValueError, TypeError, AttributeError, RuntimeError, OverflowError
    ) as error:  # fmt: skip
        raise DataError(f"not a chain.h5 of curlfit ({error})", file=path) from None
    if chain is None:
        raise DataError(
            "written by an earlier version of curlfit; sample again with `curlfit fit FILE`, "
            "without --resume",
            file=path,
        )
    try:
        return chain if fit is None else chain.with_fit(fit)
    except InputError as error:
        raise DataError(str(error), file=path) from None


def _read_chain(stored: Any) -> Chain:
    attrs, names = stored.attrs, tuple(map(str, stored.attrs["names"]))
    groups = [stored[f"ensemble-{number}"] for number in range(len(stored))]
    steps, walkers, dimension = groups[0]["chain"].shape
    if not (0 <= int(attrs["discarded"]) <= steps and walkers and dimension == len(names)):
        raise ValueError(f"{walkers} walkers of {steps} steps, {attrs['discarded']} discarded")

    def joined(name: str, *shape: int, kind: str = "f") -> Any:
        return np.concatenate([_numbers(group, name, shape, kind) for group in groups], -1)

    return Chain(
        names=names,
        values=np.concatenate(
            [_numbers(group, "chain", (steps, walkers, dimension)) for group in groups], 1
        ),
        log_posterior=joined("log_prob", steps, walkers),
        accepted=joined("accepted", walkers, kind="i"),
        discarded=int(attrs["discarded"]),
        ensembles=len(groups),
        seed=int(attrs["seed"]),
        subject=structured(json.loads(attrs["subject"]), dict[str, str]),
        random_state=_random_state(groups[0].attrs),
        mostly_ridge=attrs["mostly_ridge"].item(),
    )


def _numbers(group: Any, name: str, shape: tuple[int, ...], kind: str = "f") -> Any:
    """The numbers of a dataset, checked before memory is taken for them."""
    data = group[name]
    if data.shape != shape or data.dtype.kind != kind:
        raise ValueError(f"{name}: {data.dtype} {data.shape} found, expected {shape}")
    if data.is_virtual or data.external or data.nbytes > _COMPRESSED * data.id.get_storage_size():
        raise ValueError(f"{name}: its numbers are not in the file")
    return data[:]


def _random_state(attrs: Any) -> tuple[Any, ...] | None:
    if "random_state_0" not in attrs:
        return None
    name, key, *rest = (attrs[f"random_state_{place}"] for place in range(5))
    state = (str(name), key, *(item.item() for item in rest))
    np.random.RandomState().set_state(state)  # raises an error where it is none
    return state


def subject_of_fit(
    throw: Throw,
    law: type[Law] | str,
    load: str,
    stone: Stone,
    parameters: ParameterSet,
    loss: str = "linear",
    noise: str = "white",
) -> dict[str, str]:
    """What identifies a fit, as short texts by name; many numbers are replaced by digests."""
    sigma = [values for _, values in sorted(throw.sigma.items())]
    text = ",".join(sorted(throw.sigma)) + "".join(map(repr, throw.events))
    return {
        "data": _digest(throw.t, throw.observed, *sigma, text=text),
        **({"law": law} if isinstance(law, str) else _law(law)),
        "load": load,
        "loss": loss,
        "noise": noise,
        "stone": ", ".join(f"{name} = {value!r}" for name, value in stone.as_dict().items()),
        "bounds": "; ".join(
            f"{item.name} {item.lower!r}:{item.upper!r}" for item in parameters.parameters
        ),
        "priors": "; ".join(f"{name} {prior}" for name, prior in parameters.priors.items()),
    }


def subject_of_saved(fit: FitResult) -> dict[str, str]:
    """The same for a fit result; without the law's file where the law is not at hand."""
    return subject_of_fit(
        fit.throw, fit.law if fit.law not in LAWS else fit.law_class,
        fit.load, fit.stone, fit.parameter_set, fit.loss, fit.noise.kind,
    )  # fmt: skip


def subject_of(fit: FitResult, seed: int) -> dict[str, str]:
    """What identifies a chain, in the same form."""
    own = subject_of_saved(fit)
    noise = [fit.sigma[name] for name in sorted(fit.sigma)]
    noise += [one[name] for one in (fit.noise.memory, fit.noise.sizes) for name in sorted(one)]
    information = [np.array(fit.information[name]) for name in ("matrix", "gradient")]
    return own | {
        "least-squares result": _digest(fit.values, np.array(noise), *information),
        "seed": str(seed),
        "version of curlfit": __version__,
        "version of emcee": version_of("emcee"),
    }


def require_same(stored: Mapping[str, str], now: Mapping[str, str], file: Path) -> None:
    """Raise `DataError` if two subjects differ, and say in what."""
    for name, value in now.items():
        was = stored.get(name, "")
        if was == value:
            continue
        if value.startswith(_DIGEST):
            raise DataError(f"cannot be resumed: not the same {name} as before", file=file)
        if name == "bounds":
            value, was = _first_difference(value, was)
        if name == "priors":
            value, was = value or "none", was or "none"
        raise DataError(f"cannot be resumed: {name} was {was or 'unknown'}, now {value}", file=file)


def _first_difference(now: str, before: str) -> tuple[str, str]:
    pairs = zip(now.split("; "), before.split("; "), strict=False)
    return next((pair for pair in pairs if pair[0] != pair[1]), (now, before))


def _law(law: type[Law]) -> dict[str, str]:
    """A law by its name and, where it is a user's own, its source text."""
    source = Path(law.origin.rpartition(":")[0]).read_text() if law.origin else ""
    return {"law": law.name, "law's file": _digest(text=source)}


def _digest(*arrays: Floats, text: str = "") -> str:
    found = hashlib.sha256(text.encode())
    for array in arrays:
        array = np.asarray(array, float)
        # all zeros alike and all NaNs alike, whatever their bits
        clean = np.where(np.isnan(array), np.nan, array + 0.0)
        found.update(repr(clean.shape).encode() + clean.tobytes())
    return _DIGEST + found.hexdigest()[:16]
