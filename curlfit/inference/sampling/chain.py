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
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from curlfit.errors import DataError, InputError
from curlfit.friction import LAWS, Law
from curlfit.inference.fit.result import FitResult
from curlfit.inference.information.combinations import with_combinations
from curlfit.inference.model.parameters import ParameterSet
from curlfit.numerics.arrays import Floats
from curlfit.output.display import Displayed
from curlfit.output.files import atomic_write
from curlfit.output.frames import frame, optional
from curlfit.records import structured
from curlfit.stone import Stone
from curlfit.throws.throw import Throw
from curlfit.version import __version__

_GROUP = "mcmc"  # in which emcee looks
_COMPRESSED = 20
"""Largest size of numbers over that of their file."""
_STATE = 5  # numbers and arrays in the state of numpy's `RandomState`
_OF_0_2 = ("law", "load", "loss", "noise", "stone", "seed")
"""What of the subject of a chain of version 0.2 is said as it is today."""
_DIGEST = "#"  # first character of a digest of numbers too many to be shown


@dataclass(frozen=True, eq=False, repr=False)
class Chain(Displayed):
    """A posterior sample.

    Attributes
    ----------
    names : of the parameters, fixed ones included; of throws that vary, of what does:
        the mean, what groups and trends change, and the spread between throws.
    values : shape (steps, walkers, parameters).
    log_posterior : shape (steps, walkers); NaN where unknown.
    discarded : number of initial steps left out.
    ensembles : number of ensembles of equally many walkers.
    seed : of the random numbers.
    subject : what was sampled, see `subject_of`.
    random_state : of numpy's `RandomState` after the last step, for resuming; None
        where unknown.
    mostly_ridge : whether most proposals are made along the ridge.
    fit : the one that was sampled; None where the chain was read from a file.

    Examples
    --------
    >>> chain
    Chain, ... samples: 4 ensembles, 128 walkers, ... steps,
    of which the first ... are left out
    68 %: mu1_xi ...
    >>> chain.of({"mu1_eta": 1.0, "mu2_eta": 1.0}).mean().round(4)
    np.float64(0.0176)
    >>> chain.to_frame().index.names
    FrozenList(['ensemble', 'walker', 'step'])
    """

    kind: ClassVar[str] = "chain"

    names: tuple[str, ...]
    values: Floats
    log_posterior: Floats
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
    def accepted(self) -> NDArray[np.int64]:
        """Number of accepted proposals by walker."""
        return np.any(np.diff(self.values, axis=0) != 0, axis=2).sum(0)

    @property
    def acceptance(self) -> float:
        """Fraction of proposals accepted."""
        return float(self.accepted.mean() / max(len(self.values) - 1, 1))

    def of(self, weights: dict[str, float]) -> Floats:
        """Samples of a combination of parameters."""
        columns = [self.names.index(name) for name in weights]
        sums: Floats = self.flat[:, columns] @ np.array([*weights.values()])
        return sums

    @property
    def kept(self) -> Floats:
        """The kept samples by ensemble, shape (ensembles, walkers,
        steps, parameters)."""
        return self._by_ensemble(self.values)

    def _by_ensemble(self, series: Floats) -> Floats:
        """What is kept of a series (steps, walkers, ...), by ensemble."""
        kept = series[self.discarded :]
        steps, walkers, *other_lengths = kept.shape
        in_ensemble = walkers // self.ensembles
        by_ensemble = kept.reshape(steps, self.ensembles, in_ensemble, *other_lengths)
        return np.moveaxis(by_ensemble, 0, 2)

    def to_frame(self) -> Any:
        """The kept samples as a pandas DataFrame: a column for each parameter, for each
        determined combination of the fit (where the chain has one), and
        `log_posterior`; the index is (ensemble, walker, step).

        Raises
        ------
        InputError : pandas is not installed.
        """
        samples = self.kept
        combinations = () if self.fit is None else self.fit.combinations
        columns = with_combinations(
            self.names, samples.reshape(-1, len(self.names)), combinations
        )
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
        sampled = self.subject | {"parameters": ", ".join(self.names)}
        expected = subject_of(fit, self.seed)
        expected["parameters"] = ", ".join(fit.parameters)
        if "data" not in sampled:  # of version 0.2
            expected = {name: expected[name] for name in sampled}
        for name, version in sampled.items():
            if name.startswith("version"):  # a chain of another version can be read
                expected[name] = version
        if changed := _change(sampled, expected):
            raise InputError(
                f"the chain is of another fit: {changed}; sample this one again"
            )
        return replace(self, fit=fit)

    def to_arviz(
        self, fit: FitResult | None = None, *, draws: int = 4000, seed: int = 0
    ) -> Any:
        """The kept samples for ArviZ, one chain per ensemble: its `InferenceData` where
        ArviZ is 0.x, xarray's `DataTree` where it is 1.x.

        Groups: posterior (free parameters and determined combinations),
        posterior_predictive and log_likelihood (by channel; where noise is correlated,
        of each value given all others), log_prior (by parameter, up to a constant: 0
        where flat, so that `arviz.psense` needs a fit with priors), sample_stats (`lp`,
        up to a constant), observed_data, constant_data (`t`, `sigma_x` ...).
        The draws of a chain are those of one walker after another, labelled by the
        coordinates `walker` and `step` of `draw`. A channel with gaps has its own
        dimension, such as `time_x`. ArviZ takes one channel at a time, as in
        `arviz.loo(data, var_name="x")`; the elpd of all is the sum.

        Parameters
        ----------
        fit : the one that was sampled; needed where the chain was read from a file.
        draws : approximate number over all chains; the steps are thinned evenly.
        seed : of the noise of posterior_predictive.

        Raises
        ------
        InputError : ArviZ is not installed, there is no fit, or the chain is of
            another fit.
        """
        chain = self if fit is None else self.with_fit(fit)
        if chain.fit is None:
            raise InputError(
                "a chain that was read from a file does not hold the data; expected "
                "chain.to_arviz(fit), with the fit of the same folder"
            )
        from curlfit.inference.sampling.arviz_export import inference_data

        lp = self._by_ensemble(self.log_posterior)
        return inference_data(chain.fit, self.kept, lp, draws=draws, seed=seed)

    def save(self, file: str | PathLike[str]) -> None:
        """Write `chain.h5` atomically: a group as emcee's `HDFBackend` has it, which
        opens it, with curlfit's own attributes."""
        import h5py

        # Made in memory: HDF5 does not recover from a full disk.
        image = BytesIO()
        with h5py.File(image, "w") as out:
            group = out.create_group(_GROUP)
            group["chain"] = self.values
            group["log_prob"] = self.log_posterior
            group["accepted"] = self.accepted
            steps, walkers, dimension = self.values.shape
            random_state = {
                f"random_state_{index}": part
                for index, part in enumerate(self.random_state or ())
            }
            group.attrs.update(
                version=version_of("emcee"),
                iteration=steps,
                nwalkers=walkers,
                ndim=dimension,
                has_blobs=False,
                **random_state,
                names=list(self.names),
                discarded=self.discarded,
                ensembles=self.ensembles,
                seed=self.seed,
                subject=json.dumps(self.subject),
                mostly_ridge=self.mostly_ridge,
            )
        atomic_write(Path(file), image.getvalue())


def load_chain(file: str | PathLike[str], fit: FitResult | None = None) -> Chain:
    """Read a `chain.h5`.

    Parameters
    ----------
    fit : the one that was sampled, if the chain is to belong to it.

    Raises
    ------
    DataError : the file is missing, not valid or of an earlier version, or the chain is
        of another fit.

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

    try:
        with h5py.File(path, "r") as stored:
            chain = _read_chain(stored)
    except (
        OSError,
        LookupError,
        ValueError,
        TypeError,
        AttributeError,
        RuntimeError,
        OverflowError,
    ) as error:
        raise DataError(
            f"not a chain.h5 of this version of curlfit ({error}); "
            "sample again with `curlfit fit FILE`, without --resume",
            file=path,
        ) from None
    try:
        return chain if fit is None else chain.with_fit(fit)
    except InputError as error:
        raise DataError(str(error), file=path) from None


def _read_chain(stored: Any) -> Chain:
    """The chain in an HDF5 file."""
    group = stored[_GROUP]
    attrs = group.attrs
    is_of_0_2 = "names" in stored.attrs  # version 0.2 had them beside the group
    if is_of_0_2:
        attrs = stored.attrs
    names = tuple(map(str, attrs["names"]))
    ensembles = int(attrs["ensembles"])
    values = _numbers(group["chain"])
    log_posterior = _numbers(group["log_prob"])
    steps, walkers, dimension = values.shape
    discarded = int(attrs["discarded"])
    if (
        log_posterior.shape != (steps, walkers)
        or len(names) != dimension
        or not 0 <= discarded <= steps
        or walkers % ensembles != 0
        or walkers == 0
    ):
        raise ValueError(f"{walkers} walkers, {steps} steps, {discarded} discarded")
    subject = structured(json.loads(attrs["subject"]), dict[str, str])
    if is_of_0_2:
        subject = {name: subject[name] for name in _OF_0_2 if name in subject}
    random_state = None
    if "random_state_0" in attrs:
        name, key, *numbers = [attrs[f"random_state_{part}"] for part in range(_STATE)]
        random_state = (str(name), key, *(number.item() for number in numbers))
        np.random.RandomState().set_state(random_state)  # an error where it is none
    return Chain(
        names=names,
        values=values,
        log_posterior=log_posterior,
        discarded=discarded,
        ensembles=ensembles,
        seed=int(attrs["seed"]),
        subject=subject,
        random_state=random_state,
        mostly_ridge=bool(attrs.get("mostly_ridge", True)),
    )


def _numbers(data: Any) -> Floats:
    """The numbers of a dataset, which take little more memory than in their file."""
    if data.chunks is None:
        in_file = data.id.get_offset() is not None
    else:  # compressed, by version 0.2; numbers of a sample hardly are
        in_file = data.nbytes <= _COMPRESSED * data.id.get_storage_size()
    if not in_file or data.dtype.kind != "f":
        raise ValueError(f"{data.name}: its numbers are not in the file")
    return np.asarray(data[...], float)


def subject_of_fit(
    throw: Throw,
    law: type[Law] | str,
    load: str,
    stone: Stone,
    parameters: ParameterSet,
    loss: str,
    noise: str,
) -> dict[str, str]:
    """What identifies a fit, as short texts by name; many numbers are
    replaced by digests."""
    channels = sorted(throw.sigma)
    sigmas = [throw.sigma[name] for name in channels]
    text = ",".join(channels) + "".join(map(repr, throw.events))
    subject = {"data": digest(throw.t, throw.observed, *sigmas, text=text)}
    subject |= {"law": law} if isinstance(law, str) else _law(law)
    stone_values = stone.as_dict().items()
    priors = [f"{name} {prior}" for name, prior in parameters.priors.items()]
    subject |= {
        "load": load,
        "loss": loss,
        "noise": noise,
        "stone": ", ".join(f"{name} = {value!r}" for name, value in stone_values),
        "priors": "; ".join(priors) or "none",
    }
    for parameter in parameters.parameters:
        bounds = f"{parameter.lower!r}:{parameter.upper!r}"
        subject[f"bounds of {parameter.name}"] = bounds
    return subject


def subject_of_saved(fit: FitResult) -> dict[str, str]:
    """What identifies a fit, from its result; without the law's file where the law is
    not at hand."""
    return subject_of_fit(
        fit.throw,
        fit.law if fit.law not in LAWS else fit.law_class,
        fit.load,
        fit.stone,
        fit.parameter_set,
        fit.loss,
        fit.noise.kind,
    )


def subject_of(fit: FitResult, seed: int) -> dict[str, str]:
    """What identifies a chain, as short texts by name."""
    estimates_of_noise = [fit.sigma]
    for name in (*fit.noise.parameters, "sizes"):
        estimates_of_noise.append(getattr(fit.noise, name))
    noise = [
        estimates[key] for estimates in estimates_of_noise for key in sorted(estimates)
    ]
    matrix = np.array(fit.information.matrix)
    gradient = np.array(fit.information.gradient)
    return subject_of_saved(fit) | {
        "least-squares result": digest(fit.values, np.array(noise), matrix, gradient),
        "seed": str(seed),
        "version of curlfit": __version__,
        "version of emcee": version_of("emcee"),
    }


def require_same(stored: Mapping[str, str], now: Mapping[str, str], file: Path) -> None:
    """Raise `DataError` if two subjects differ, and say in what."""
    if changed := _change(stored, now):
        raise DataError(f"cannot be resumed: {changed}", file=file)


def _change(stored: Mapping[str, str], now: Mapping[str, str]) -> str:
    """The first difference between two subjects in words; empty if there is none."""
    for name, value in now.items():
        before = stored.get(name, "unknown")
        if before == value:
            continue
        if value.startswith(_DIGEST):
            return f"not the same {name}"
        return f"{name} was {before}, now {value}"
    return ""


def _law(law: type[Law]) -> dict[str, str]:
    """A law by its name and, where it is a user's own, its source text."""
    source = Path(law.origin.rpartition(":")[0]).read_text() if law.origin else ""
    return {"law": law.name, "law's file": digest(text=source)}


def digest(*arrays: Floats, text: str = "") -> str:
    """A short text that differs for other numbers or another text."""
    content = hashlib.sha256(text.encode())
    for array in arrays:
        numbers = np.asarray(array, float)
        # all zeros alike and all NaNs alike, whatever their bits
        clean = np.where(np.isnan(numbers), np.nan, numbers + 0.0)
        content.update(repr(clean.shape).encode() + clean.tobytes())
    return _DIGEST + content.hexdigest()[:16]
