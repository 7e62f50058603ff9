"""The commands that two versions of curlfit are asked, in cases of their own folder.

The commands of a case are carried out one after the other in one folder, so that later
ones can use the results of earlier ones. `DATA` stands for the folder of the shipped
files, `THROWS` for that of the synthetic ones.
"""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from itertools import count, cycle
from pathlib import Path

import numpy as np

import curlfit

PAPER = "DATA/jensen_shegelski_2004.csv"
AXES = "--axes x-left,counter-clockwise --since 0.533"
NOISE = {"x": 0.005, "y": 0.005, "phi": 0.01}
"""Of the synthetic throws, in m, m and rad."""


@dataclass(frozen=True)
class Case:
    """Commands that are carried out one after the other in a folder of that name."""

    name: str
    commands: tuple[tuple[str, ...], ...]


SHIPPED = {
    "paper": f"""
        check {PAPER}
        fit {PAPER}
        show jensen_shegelski_2004-fit
        plot jensen_shegelski_2004-fit --out drawn
        report jensen_shegelski_2004-fit
        export jensen_shegelski_2004-fit --to csv --to latex --to json --to game
        profile jensen_shegelski_2004-fit --param mu1_eta --param mu2_eta
        predict jensen_shegelski_2004-fit --v0 2.1 --omega0 1.2 --out free
        predict jensen_shegelski_2004-fit --to-tee --turn both --report --out to-tee
        simulate --fit jensen_shegelski_2004-fit --omega0=-1.2 --out mirrored.csv
    """,
    "first seconds": f"""
        fit {PAPER} --until 12 --no-sample --out first-12-s
        predict first-12-s --check {PAPER} --out checked
    """,
    "consistent load": f"""
        fit {PAPER} --load consistent --no-sample --out fitted
        profile fitted --param mu2_xi --report --out profiled
    """,
    "choices": f"""
        fit {PAPER} --no-sample --fix phi0=0 --out fixed
        fit {PAPER} --no-sample --bound mu2_xi=0:0.05 --out bounded
        fit {PAPER} --no-sample --prior rho=0.1+-0.0025 --out prior
        fit {PAPER} --no-sample --free slope_x --out free
        fit {PAPER} --no-sample --sweep 8:14 --out swept
        fit {PAPER} --no-sample --exclude 3:5 --systematic slope_x=0 --out excluded
        fit {PAPER} --no-sample --derive "mu2_xi - mu1_xi" --out derived
        fit {PAPER} --no-sample --noise ar1 --out ar1
        fit {PAPER} --no-sample --noise discrepancy --out discrepancy
        fit {PAPER} --no-sample --loss huber --out huber
        fit {PAPER} --no-sample --law no-such-law --out refused
    """,
    "laws compared": f"compare {PAPER} --report",
    "data sets compared": f"""
        compare {PAPER} DATA/sutor_1988_friction.csv --laws front-back,power+pivot
    """,
    "camera": f"""
        check DATA/camera_1.csv
        fit DATA/camera_1.csv DATA/camera_2.csv {AXES} --out joint --no-sample
        report joint
    """,
    "tracker": """
        fit DATA/tracker.txt --handle 2 --axes x-along --no-sample --report
    """,
    "pixels": """
        check DATA/film.csv --reference DATA/film_points.csv
        fit DATA/film.csv --reference DATA/film_points.csv --no-sample
    """,
    "friction table": """
        fit DATA/sutor_1988_friction.csv --law sutor
        compare DATA/sutor_1988_friction.csv --laws coulomb,power,stribeck,sutor
    """,
    "stopwatch": """
        check DATA/evening.csv
        fit DATA/evening.csv --no-sample
    """,
    "two sheets": """
        fit DATA/two_sheets.csv --by sheet --trend start --no-sample --out evening
        predict evening --sheet 2 --to-tee --turn in --report --out next
        report evening
    """,
    "season": """
        batch THROWS/season --sigma x=.005,y=.005,phi=.01 --out season.csv
        fit season.csv --no-sample
        fit THROWS/season --no-sample --sigma x=.005,y=.005,phi=.01 --out joint
        predict joint --to-tee --turn in --out next
    """,
    "design": """
        design --report
        design --law front-back --load consistent --separate mu1_eta,mu2_eta --out split
    """,
    "rivals": """
        design --between front-back,pivot --v0 2 --omega0 2 --rate 10 --out deciding
    """,
    "simulated": """
        simulate --noise-xy 0.005 --noise-phi 0.01 --seed 1 --out plain.csv
        simulate --law coulomb --load consistent --drag 0.8 --slope-x 2e-4
        simulate --law power --sweep 8:14=0.9 --line hog --out swept.csv
    """,
    "words": """
        laws
        laws --conditions
        fit no-such-file.csv
        predict no-such-folder
    """,
    "claims of the paper": "reproduce",
}
"""The commands of each case, one a line."""

QUICK = """
    check DATA/jensen_shegelski_2004.csv
    fit DATA/jensen_shegelski_2004.csv --no-sample --out fitted
    fit DATA/jensen_shegelski_2004.csv --bound mu2_xi=0:0.05 --no-sample --out bounded
    show fitted
    report fitted
    export fitted --to csv --to latex
    laws
    fit no-such-file.csv
"""
"""What the ordinary tests compare, within a minute."""

LOSSES = cycle(["huber", "soft-l1", "cauchy", "student"])
NOISE_MODELS = cycle(["discrepancy", "ar1"])
CONDITIONS = cycle(["--free slope_x", "--free drag", "--prior rho=0.1+-0.0025"])
CHOICES = cycle(["coefficient", "condition", "condition", "coefficient"])
TIMED = ("coulomb", "power", "front-back", "angular", "stribeck", "semi-empirical")
"""Laws that are fitted to a record of stopwatch times."""
RECORD = """\
hog_to_hog = 14.2
hog_to_rest = 10.5
curl = {curl:.2f} m left
rest = 0.6
"""


def command_lines(text: str) -> tuple[tuple[str, ...], ...]:
    """The words of each line."""
    return tuple(tuple(shlex.split(line)) for line in text.strip().splitlines())


def shipped_cases() -> list[Case]:
    """The cases of the shipped files."""
    return [Case(name, command_lines(text)) for name, text in SHIPPED.items()]


def own_cases(folder: Path) -> list[Case]:
    """Each table in a folder of one's own is checked and fitted by its defaults."""
    tables = sorted((*folder.glob("*.csv"), *folder.glob("*.txt")))
    return [
        Case(
            f"own {table.name}",
            (("check", str(table)), ("fit", str(table), "--no-sample")),
        )
        for table in tables
    ]


def synthetic_cases(folder: Path) -> list[Case]:
    """Write 200 synthetic throws of all laws to a folder, and ask a fit of each.

    Under each load there are five throws of each law, of the variants `options_of`. The
    other ten, of the front-back law in the folder `season`, are fitted together by a
    case of the shipped files.
    """
    seeds = count(1)
    cases = []
    for name, law in curlfit.LAWS.items():
        for load in ("uniform", "consistent"):
            commands = []
            for variant, options in options_of(law, load).items():
                throw = f"{name}-{load}-{variant}".replace(" ", "-")
                table = throw_table(
                    law(),
                    load,
                    seed=next(seeds),
                    spin=0.0 if variant == "no spin" else 1.2,
                    with_angle=variant != "no angle",
                )
                (folder / f"{throw}.csv").write_text(table)
                words = f"fit THROWS/{throw}.csv --law {name} --load {load} {options}"
                commands.append(f"{words} --no-sample --no-figures --out '{variant}'")
            cases.append(Case(f"{name} {load}", command_lines("\n".join(commands))))
    (folder / "season").mkdir(exist_ok=True)
    for number in range(10):
        law = curlfit.law_with("front-back", {"mu2_xi": 0.049 + 0.0005 * number})
        spin = 1.2 if number % 2 else -1.2
        table = throw_table(law, "uniform", seed=next(seeds), spin=spin)
        (folder / "season" / f"throw{number}.csv").write_text(table)
    return cases


def options_of(law: type[curlfit.Law], load: str) -> dict[str, str]:
    """Options of a fit by the variant of the throw: by default, with a robust loss,
    with a noise model, with a choice about a coefficient or a condition, and of a throw
    that lacks the angle or the spin."""
    coefficient = law.coefficients()[0]
    if load == "uniform":
        about_coefficient = f"--fix {coefficient.name}={coefficient.default}"
        lacking = "no angle"
    else:
        about_coefficient = f"--bound {coefficient.name}=0:{0.8 * coefficient.default}"
        lacking = "no spin"
    choices = {"coefficient": about_coefficient, "condition": next(CONDITIONS)}
    sigma = ",".join(f"{channel}={size}" for channel, size in NOISE.items())
    return {
        "plain": "",
        "loss": f"--loss {next(LOSSES)}",
        "noise": f"--noise {next(NOISE_MODELS)}",
        "choice": choices[next(CHOICES)],
        lacking: f"--sigma {sigma}",
    }


def throw_table(
    law: curlfit.Law, load: str, *, seed: int, spin: float, with_angle: bool = True
) -> str:
    """A simulated throw of 18 s at 10 Hz, as the text of a table."""
    times = np.linspace(0.0, 18.0, 181)
    start = curlfit.InitialState(v=2.1, omega=spin)
    path = curlfit.simulate(law, curlfit.Stone(), start, times, load=load).to_numpy()
    random = np.random.default_rng(seed)
    columns = {"t": times}
    for channel, size in NOISE.items():
        noise = size * random.standard_normal(len(times))
        columns[channel] = getattr(path, channel) + noise
    if not with_angle:
        del columns["phi"]
    rows = zip(*columns.values(), strict=True)
    lines = [",".join(columns), *(",".join(f"{x:.6f}" for x in row) for row in rows)]
    return "\n".join(lines) + "\n"


def timed_cases(folder: Path) -> list[Case]:
    """Records of stopwatch times and a curl, of which several laws are asked."""
    file = folder / "record.txt"
    file.write_text(RECORD.format(curl=1.2))
    lines = [
        f"fit THROWS/record.txt --law {law} --no-sample --no-figures --out {law}"
        for law in TIMED
    ]
    return [Case("stopwatch record", command_lines("\n".join(lines)))]
