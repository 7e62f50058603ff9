"""Damaged records, and what the command does with each.

`python damaged_records.py FOLDER SEED COUNT` damages the results in the folders of
FOLDER, one at a time, lets the command read each, as `damaged_files` does, and prints a
`Tally` as JSON. Without FOLDER/fit it first makes results of all kinds there:
`python damaged_records.py FOLDER 1 20000`.
"""

from __future__ import annotations

import gc
import json
import random
import shutil
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout, suppress
from copy import deepcopy
from dataclasses import asdict
from io import StringIO
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import h5py
import numpy as np
from damaged_files import Tally, damaged_text, forked

from curlfit.cli import main
from curlfit.output.kinds import KINDS

_VALUES = [
    None,
    True,
    False,
    0,
    1,
    -1,
    2,
    10**6,
    10**30,
    10**400,
    0.5,
    -0.5,
    1e-320,
    1e99,
    1e300,
    "",
    "x",
    "inf",
    "-inf",
    "nan",
    "1",
    "é\u2028",
    "x" * 10_000,
    [],
    {},
    [[]],
    [1],
    ["x"],
    [None],
    {"x": 1},
    {"": {}},
    [0.5, "x"],
    [[1, 2], [3]],
    [0.0] * 1000,
    "../..",
    "notes.py:Mine",
    "mine",
]
_WEIGHTS = {"show": 76, "json": 9, "export": 9, "report": 3, "plot": 3}


def save_all(folder: Path) -> None:
    """Results of all kinds, each in its folder."""
    from conftest import DATA
    from report_records import of_all

    import curlfit
    from curlfit.inference.together.result import folder_name

    results = of_all(curlfit.load_throw(DATA))
    names = {"prediction": "predict", "comparison": "compare"}
    chain = results.pop("chain")
    for name, result in results.items():
        kind = names.get(name, name)
        (folder / kind).mkdir()
        result.save(folder / kind / f"{kind}.json")
    chain.save(folder / "fit" / "chain.h5")
    for fit in results["joint"].throws:
        throw_folder = folder / "joint" / folder_name(fit.data.file)
        throw_folder.mkdir(exist_ok=True)
        fit.save(throw_folder / "fit.json")


def places(value: Any) -> Iterator[tuple[Any, Any]]:
    """Every container of a record with each of its keys."""
    members = value.items() if isinstance(value, dict) else enumerate(value)
    for key, member in members:
        yield value, key
        if isinstance(member, dict | list):
            yield from places(member)


def damage(chance: random.Random, text: str) -> str:
    """The JSON of a record with some damage."""
    if chance.random() < 0.15:
        return damaged_text(chance, text)
    record = json.loads(text)
    for _ in range(chance.choice([1, 1, 1, 2, 4])):
        all_ = [
            slot
            for slot in places(record)
            if isinstance(slot[0], dict) or chance.random() < 0.02
        ]
        if not all_:
            break
        holder, key = chance.choice(all_)
        kind = chance.random()
        if kind < 0.2:
            del holder[key]
        elif kind < 0.3 and isinstance(holder, dict):
            holder[chance.choice(["x", "", "t", f"{key}s"])] = holder.pop(key)
        elif kind < 0.4 and isinstance(holder[key], list):
            del holder[key][chance.randrange(len(holder[key]) + 1) :]
        elif kind < 0.5 and type(holder[key]) in (int, float):
            holder[key] *= chance.choice([-1, 0, 1e3, 1e-9, 1e40, 1e-40])
        elif kind < 0.6:
            other = chance.choice(all_)
            holder[key] = deepcopy(other[0][other[1]])
        else:
            holder[key] = chance.choice(_VALUES)
    damaged = json.dumps(record)
    if chance.random() < 0.03:
        deep = chance.choice([20, 300, 900, 100_000])
        damaged = damaged.replace(": 0", f": {'[' * deep}{']' * deep}", 1)
    return damaged


def damage_chain(chance: random.Random, file: Path) -> None:
    """Damage a `chain.h5` where it is."""
    if chance.random() < 0.2:
        raw = bytearray(file.read_bytes())
        for _ in range(chance.choice([1, 4])):
            raw[chance.randrange(len(raw))] = chance.randrange(256)
        file.write_bytes(raw[: chance.choice([len(raw), len(raw), len(raw) // 2])])
        return
    with h5py.File(file, "r+") as out:
        name = chance.choice(["mcmc/chain", "mcmc/log_prob", "mcmc/accepted"])
        data = out[name]
        kind = chance.random()
        if kind < 0.5:
            value = data[:]
            shape = chance.choice(
                [(10**7, 32, 10), (10**7,), (3,), value.shape[1:], ()]
            )
            del out[name]
            if np.prod(shape) > 10**6:
                out.create_dataset(name, shape, "f8", chunks=True, compression="gzip")
            else:
                out[name] = chance.choice(
                    [np.zeros(shape), np.full(shape, b"x"), value[:-1]]
                )
        elif kind < 0.6:
            del out[name]
        else:
            group = out["mcmc"]
            key = chance.choice(list(group.attrs))
            del group.attrs[key]
            values = [-1, 0, 7, 10**9, 0.5, "x", "[" * 5000, "{}", [1, 2], ["a", "b"]]
            if chance.random() < 0.8:
                group.attrs[key] = chance.choice(values)


def tally(samples: Path, seed: int, count: int) -> Tally:
    """What becomes of `count` damaged records of a seed."""
    chance = random.Random(seed)
    outcomes = Tally()
    work = samples.parent / f"{samples.name}-work-{seed}"
    folders = sorted(folder for folder in samples.iterdir() if folder.is_dir())
    for k in range(count):
        folder = chance.choice([*folders, samples / "fit"])
        shutil.rmtree(work, ignore_errors=True)
        shutil.copytree(folder, work)
        kind = next(kind for kind in KINDS if (work / f"{kind}.json").exists())
        if (work / "chain.h5").exists() and chance.random() < 0.4:
            damage_chain(chance, work / "chain.h5")
        else:
            file = work / f"{kind}.json"
            if kind == "joint" and chance.random() < 0.3:
                file = chance.choice(list(work.glob("*/fit.json")))
            file.write_text(damage(chance, file.read_text()))
        verb = chance.choices(list(_WEIGHTS), list(_WEIGHTS.values()))[0]
        words = {
            "show": ["show", f"{work}"],
            "json": ["show", f"{work}", "--json"],
            "export": [
                "export",
                f"{work}",
                "--to=csv",
                "--to=latex",
                f"--out={work / 'out'}",
            ],
            "report": ["report", f"{work}"],
            "plot": ["plot", f"{work}"],
        }[verb]
        if verb == "export" and kind not in ("fit", "joint", "compare"):
            words = ["show", f"{work}"]
        before = len(outcomes.faults)
        outcome = forked(words, work.with_suffix(".errors"))
        outcomes.add(outcome, f"seed {seed}, record {k}, {words}")
        if len(outcomes.faults) > before:
            shutil.copytree(
                work, work.with_name(f"fault-{seed}-{k}"), dirs_exist_ok=True
            )
    shutil.rmtree(work)
    return outcomes


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    seed = int(sys.argv[2])
    count = int(sys.argv[3])
    folder.mkdir(exist_ok=True)
    if not (folder / "fit").exists():
        with get_context("spawn").Pool(1) as own:  # JAX has threads, which a copy lacks
            own.apply(save_all, (folder,))
    # What the copies of this process would otherwise import, each for itself; a page
    # may load JAX, whose threads a copy lacks.
    warm = folder.with_name("warm")
    for one in sorted(folder.iterdir()):
        for words in (["show", f"{one}"], ["plot", f"{one}", f"--out={warm}"]):
            with redirect_stdout(StringIO()), suppress(SystemExit):
                sys.argv[1:] = words
                main()
    shutil.rmtree(warm)
    gc.freeze()  # pages that copies need not write to
    print(json.dumps(asdict(tally(folder, seed, count))))
