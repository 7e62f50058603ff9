"""How a result was made: settings, versions, and a command line that reproduces it."""

from __future__ import annotations

import math
import platform
import shlex
from collections.abc import Mapping, Sequence
from contextlib import suppress
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from curlfit.comparison.result import Comparison
from curlfit.errors import CurlfitError
from curlfit.friction import Parameter
from curlfit.html_report.document import Block, Section, rows, section
from curlfit.inference.conditions import CALIBRATION, CONDITIONS, WIDTHS
from curlfit.inference.fit.result import FitResult
from curlfit.inference.joint.result import JointResult
from curlfit.inference.parameters import START
from curlfit.optimal_design.result import Design
from curlfit.prediction.result import Prediction
from curlfit.stone import Stone
from curlfit.version import __version__

_PACKAGES = ("jax", "numpy", "scipy", "matplotlib")


def made_by(
    settings: Mapping[str, str], commands: Sequence[str], notes: Sequence[str] = ()
) -> Section:
    """The section on how a result was made."""
    commanded = Block("commands", {"lines": tuple(commands), "notes": tuple(notes)})
    return section(
        "made", "How to reproduce this result",
        commanded, rows("Settings", settings), rows("Versions that wrote this page", _versions()),
    )  # fmt: skip


def _versions() -> dict[str, str]:
    found = {"curlfit": __version__, "Python": platform.python_version()}
    for name in _PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found


def _number(value: float) -> str:
    return f"{value:.10g}"


def _pairs(flag: str, values: Mapping[str, float]) -> list[str]:
    """`--flag=name=value` for each, so that negative values are not mistaken for flags."""
    return [f"{flag}={name}={_number(value)}" for name, value in values.items()]


def _stone(stone: Stone) -> list[str]:
    text = ",".join(f"{name}={_number(value)}" for name, value in stone.as_dict().items())
    return [f"--stone={text}"]


def _line(*words: str) -> str:
    return shlex.join(["curlfit", *words])


def stone_text(stone: Stone) -> str:
    """Constants of a stone."""
    return f"R = {stone.R:g} m, rho = {stone.rho:g} m, h = {stone.h:g} m, m = {stone.m:g} kg"


def rows_text(data: Mapping[str, Any]) -> str:
    """Which rows of a file were used."""
    said = [f"{data['rows']} rows, t = {data['from']:g} .. {data['to']:g} s"] * bool(data["rows"])
    said += [f"without {a:g} .. {b:g} s" for a, b in data.get("exclude") or ()]
    return ", ".join(said) or "timed events alone"


def fit_settings(fit: FitResult) -> dict[str, str]:
    """The settings of a fit."""
    found = {
        "Law, load": f"{fit.law}, {fit.load}",
        "Data": f"{fit.data['file']}, {rows_text(fit.data)}",
        "Stone": stone_text(fit.stone),
        "Loss, noise": f"{fit.loss}, {fit.noise.kind}",
    }
    held = [f"{name} = {item.value:g}" for name, item in fit.parameters.items()
            if item.verdict == "fixed"]  # fmt: skip
    if held:
        found["Held"] = ", ".join(held)
    priors = [f"{name} {item.prior}" for name, item in fit.parameters.items() if item.prior]
    if priors:
        found["Priors"] = ", ".join(priors)
    bounds = [
        f"{name} {item.lower:g} .. {item.upper:g}" for name, item in fit.coefficients.items()
        if item.verdict != "fixed"
    ]  # fmt: skip
    if bounds:
        found["Bounds"] = ", ".join(bounds)
    widths = {name: value for name, value in fit.systematics.settings.items() if value}
    if widths:
        found["Standard uncertainty of what is held"] = ", ".join(
            f"{name} {value:g}" for name, value in widths.items()
        )
    if fit.posterior is not None:
        found["Posterior"] = (
            f"{fit.posterior.samples} samples, {fit.posterior.walkers} walkers, "
            f"{fit.posterior.steps} steps, seed {fit.posterior.seed}"
        )
    return found


def fit_command(fit: FitResult) -> str:
    """The command line of a fit, as far as it is recorded."""
    words = ["fit", _file(fit.data["file"]), *fit_flags(fit)]
    if fit.posterior is not None:
        words.append(f"--seed={fit.posterior.seed}")
    elif fit.sampling == "none":
        words.append("--no-sample")
    return _line(*words)


def fit_flags(fit: FitResult) -> list[str]:
    """The flags of a fit, as far as they are recorded and differ from the defaults."""
    data = fit.data
    words = [f"--law={data.get('law_file') or fit.law}", f"--load={fit.load}", *_stone(fit.stone)]
    words += [f"--{name}={_number(data[name])}" for name in ("since", "until")
              if data.get(name) is not None]  # fmt: skip
    words += [f"--exclude={_number(a)}:{_number(b)}" for a, b in data.get("exclude") or ()]
    if data.get("swept"):
        words.append("--sweep=" + ":".join(map(_number, data["swept"])))
    usual = _usual(fit)
    assumed = {**fit.throw.assumed} if fit.events else {}
    for name, item in fit.parameters.items():
        own = usual.get(name, item)  # of a law that is not at hand, as if usual
        if item.verdict == "fixed":
            default = getattr(own, "default", None) if getattr(own, "optional", False) else None
            unseen = own in START and item.value == 0.0
            if name not in assumed and item.value != default and not unseen:
                words += _pairs("--fix", {name: item.value})
            continue
        if item.prior:
            words.append(f"--prior={name}={item.prior}")
        elif (name in fit.conditions and name != "sweep") or getattr(own, "optional", False):
            words.append(f"--free={name}")
        limits = (own.lower, own.upper)
        if (item.lower, item.upper) != limits and not item.prior:
            words.append(f"--bound={name}={_number(item.lower)}:{_number(item.upper)}")
    words += [f"--loss={fit.loss}"] * (fit.loss != "linear")
    words += [f"--noise={fit.noise.kind}"] * (fit.noise.kind != "white")
    held = {
        name: width for name, width in fit.systematics.settings.items()
        if not math.isclose(width, (WIDTHS | {CALIBRATION: 1.0})[name], rel_tol=1e-12)
    }  # fmt: skip
    words += _pairs("--systematic", held)
    return [*words, *(f"--derive={item.expression}" for item in fit.derived)]


def _usual(fit: FitResult) -> dict[str, Parameter]:
    """The default parameters of a fit; without coefficients if a user's law is not at hand."""
    found: tuple[Parameter, ...] = (*CONDITIONS, *START)
    with suppress(CurlfitError):
        found += fit.law_class.coefficients()
    return {item.name: item for item in found}


def _file(name: str) -> str:
    """The file of a throw, from a name that may include a row of the file."""
    return name.partition(" row ")[0]


def reading_notes(data: Mapping[str, Any]) -> list[str]:
    """How the file was read, which is recorded only in its notes: further flags may be needed."""
    if not data.get("notes"):
        return []
    return [
        "How the file was read, for which its flags (--axes, --units ...) are needed again: "
        + "; ".join(data["notes"])
    ]


def data_files(joint: JointResult) -> list[str]:
    """The files of the throws, each once."""
    return list(dict.fromkeys(_file(one.data["file"]) for one in joint.throws))


def joint_command(joint: JointResult) -> str:
    """The command line of a joint fit, as far as it is recorded."""
    files = data_files(joint)
    flags = [f for f in fit_flags(joint.throws[0]) if not f.startswith("--derive")]
    if tuple(joint.share) != tuple(joint.throws[0].coefficients):
        flags.append("--share=" + ",".join(joint.share))
    flags += [f"--derive={item.expression}" for item in joint.derived]
    return _line("fit", *files, *flags)


def comparison_command(found: Comparison) -> str:
    """The command line of a comparison, as far as it is recorded."""
    loads = {item.load for item in found.candidates} - {"-"}
    load = "both" if len(loads) > 1 else next(iter(loads), "uniform")
    laws = dict.fromkeys(item.law for item in found.candidates)
    words = ["compare", found.data["file"], f"--load={load}", "--laws=" + ",".join(sorted(laws))]
    words += _stone(found.stone)
    words += [f"--until={_number(found.data['to'])}"] * bool(found.data["rows"])
    words += [f"--loss={found.loss}"] * (found.loss != "linear")
    words += [f"--noise={found.noise}"] * (found.noise != "white")
    return _line(*words)


def profile_command(file: str, names: Sequence[str]) -> str:
    """The command line of a profile, from a fit under its default name."""
    flags = [f"--param={name}" for name in names]
    return _line("profile", f"{Path(file).stem}-fit", *flags)


def prediction_command(found: Prediction) -> str:
    """The command line of a prediction, from a fit under its default name."""
    words = ["predict", f"{Path(found.fit['file']).stem}-fit"]
    words += [
        f"--{name}={_number(item['value'])}"
        for name, item in found.start.items()
        if item["origin"] == "given"
    ]
    words += [f"--from={found.line}"] * bool(found.line)
    goal = found.goal
    if goal is not None:
        if goal["words"] in ("draw", "guard", "takeout"):
            words.append(f"--weight={goal['words']}")
            words += [f"--tee-speed={_number(goal['speed'])}"] * (goal["words"] == "takeout")
        elif goal["words"] == "to the tee":
            words.append("--to-tee")
        else:
            words.append(f"--target={_number(goal['x'])},{_number(goal['y'])}")
    words += [f"--draws={found.draws['number']}", f"--seed={found.draws['seed']}"]
    if found.check is not None:
        words.append(f"--check={found.check.file}")
    return _line(*words)


def design_command(found: Design) -> str:
    """The command line of a design, as far as it is recorded."""
    words = ["design", f"--law={found.law}", f"--load={found.load}", *_stone(found.stone)]
    words += _pairs("--set", found.coefficients)
    for flag, names in (("xy", ("x",)), ("phi", ("phi",)), ("speed", ("speed",)),
                        ("omega", ("omega",))):  # fmt: skip
        value = next((found.sigma[name] for name in names if name in found.sigma), None)
        if value is not None:
            words.append(f"--sigma-{flag}={_number(value)}")
        elif flag in ("xy", "phi"):
            words.append(f"--sigma-{flag}=none")
    for name in ("v0", "omega0", "rate"):
        values = dict.fromkeys(getattr(one, name) for one in found.candidates)
        words.append(f"--{name}=" + ",".join(map(_number, values)))
    if found.until is not None:
        words.append(f"--until={_number(found.until)}")
    words.append(f"--throws={found.throws}")
    if found.discrepancy:
        words.append(f"--discrepancy={_number(found.discrepancy)}")
    if found.separation is not None:
        words.append("--separate=" + ",".join(found.separation.pair))
        words.append(f"--relative-error={_number(found.separation.wanted)}")
    return _line(*words)
