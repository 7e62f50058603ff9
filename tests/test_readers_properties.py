"""Generated files: the same throw in every guise, and nothing but a sentence for what is none."""

from __future__ import annotations

import math
import random

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from sample_files import OMEGA, PHI, SAMPLES, N, T, X, Y, known_points, table

from curlfit import InputError, load_throw
from curlfit.readers import FORMATS

UNITS = {
    "t": {"t": 1.0, "time_s": 1.0, "Time [ms]": 1e-3, "t_min": 60.0, "elapsed (s)": 1.0},
    "x": {"x": 1.0, "x_cm": 0.01, "pos_x (mm)": 1e-3, "X [ft]": 0.3048, "x (in)": 0.0254},
    "y": {"y": 1.0, "y_ft": 0.3048, "y-position (m)": 1.0, "ypos_yd": 0.9144},
    "phi": {"phi": 1.0, "angle_deg": math.pi / 180, "θ (°)": math.pi / 180,
            "rotation [rev]": 2 * math.pi, "theta_rad": 1.0},
    "omega": {"omega": 1.0, "spin_rpm": math.pi / 30, "gyro (deg/s)": math.pi / 180,
              "ω (rad/s)": 1.0},
}  # fmt: skip
WANTED = {"t": T, "x": X, "y": Y, "phi": PHI, "omega": OMEGA}


@given(data=st.data())
@settings(
    max_examples=120, deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)  # fmt: skip
def test_the_same_throw_however_it_is_written(tmp_path, data):
    draw = data.draw
    separator = draw(st.sampled_from([",", ";", "\t", " "]))
    comma = draw(st.booleans()) and separator != ","
    encodings = ["utf-8", "utf-8-sig", "utf-16"]
    headers = {name: draw(st.sampled_from(list(UNITS[name]))) for name in WANTED}
    if separator == " ":
        encodings = encodings[:2]
    if not set("θω") & set("".join(headers.values())):
        encodings.append("cp1252")
    order = draw(st.permutations([n for n in WANTED if n != "omega" or draw(st.booleans())]))
    wrap = draw(st.sampled_from([None, (0.0, 2 * math.pi), (-math.pi, 2 * math.pi)]))
    gaps = draw(st.lists(st.tuples(st.sampled_from(["x", "y", "phi"]),
                                   st.integers(0, N - 1)), max_size=12))  # fmt: skip
    expected = {name: WANTED[name].copy() for name in order}
    for name, row in gaps:
        expected[name][row] = np.nan
    columns = {}
    for name in order:
        values = expected[name]
        if name == "phi" and wrap:
            values = np.remainder(values - wrap[0], wrap[1]) + wrap[0]
        header = headers[name].replace(" ", "_") if separator == " " else headers[name]
        columns[header] = values / UNITS[name][headers[name]]
    text = table(columns, separator, comma=comma)
    text = draw(st.sampled_from(["", "# filmed\n", "\n"])) + text
    text = text.replace("\n", draw(st.sampled_from(["\n", "\r\n", "\r"])))
    file = tmp_path / "throw.txt"
    file.write_bytes(text.encode(draw(st.sampled_from(encodings))))

    throw = load_throw(file)
    for name in ("t", "x", "y"):
        np.testing.assert_allclose(getattr(throw, name), expected[name], rtol=1e-9, atol=1e-9)
    seen = np.isfinite(expected["phi"])
    np.testing.assert_array_equal(np.isfinite(throw.phi), seen)
    off = (throw.phi - expected["phi"])[seen]
    np.testing.assert_allclose(off, off[0], atol=1e-9)  # the zero of a wrapped angle is lost
    if not wrap:
        assert abs(off[0]) < 1e-9
    if "omega" in order:
        np.testing.assert_allclose(throw.omega, OMEGA, rtol=1e-9, atol=1e-9)


_PIECES = [
    "", ",", ";", "\t", " ", "\n", "\r", '"', "'", "#", "=", "nan", "inf", "-inf", "1e999", "-",
    "--", "1e308", "-1e308", "1e-320", "999999999999999999999", "1_0", "0x1p3", "١٢", "NaN", "null",
    "true", "{", "}", "[", "]", "{}", "[]", ":", "[" * 3000, "0" * 5000, "9" * 5000, "\x00",
    "\ufeff", "\u2028", "\x1c", "\x85", "é", "θ_{r}", "t", "x", "y", "u", "v", "phi", "t_phi",
    "# axes = 'x-along'\n", "# until = inf\n", "# stone = {R = 1}\n", "# sigma.x = 1\n",
    "# reference.law = 1\n", "# law = 'nothing'\n", "hog_to_hog = 1\n", "curl = 1e5 ft\n",
    '"trajectory": 1', '"team": 3', '"index": -1', '"index": true', "0.25", "-0.25", "1e9",
]  # fmt: skip


def mutated(chance: random.Random) -> tuple[bytes, dict]:
    """A sample with some damage, and arguments to read it with."""
    text = chance.choice(list(SAMPLES.values()))
    for _ in range(chance.choice([1, 1, 1, 2, 5])):
        a, b = sorted(chance.randrange(len(text) + 1) for _ in range(2))
        kind = chance.choice([0, 1, 2, 2, 2, 3, 3, 4, 4, 5, 6, 6, 8, 8, 8, 8, 7])
        if kind == 0:
            text = text[:a]
        elif kind == 1:
            text = text[:a] + text[min(b, a + 30) :]
        elif kind == 2:
            text = text[:a] + chance.choice(_PIECES) + text[a:]
        elif kind == 3:
            text = text[:a] + chance.choice(_PIECES) + text[min(b, a + 5) :]
        elif kind == 4:  # a line lost, doubled or moved
            lines = text.split("\n")
            k = chance.randrange(len(lines))
            line = lines.pop(k)
            lines[chance.randrange(len(lines) + 1) : 0] = [line] * chance.randrange(3)
            text = "\n".join(lines)
        elif kind == 5:
            one, other = chance.sample([",", ";", "\t", " ", ".", "\n", "0", "1", "-"], 2)
            text = text.replace(one, other, chance.choice([1, 5, -1]))
        elif kind == 8:  # another digit
            text = text[:a] + chance.choice("0123456789") + text[a + 1 :]
        elif kind == 6:
            text = text[:a] + chr(chance.choice([0, 9, 11, 34, 44, 59, 127, 160, 8722])) + text[a:]
        else:
            text = text[a : a + 300] + text[b:]
        text = text[:200_000] or " "
    raw = text.encode(chance.choice(["utf-8"] * 6 + ["utf-8-sig", "utf-16", "utf-16-le"]))
    if chance.random() < 0.2:
        k = chance.randrange(len(raw))
        raw = raw[:k] + bytes([chance.randrange(256)]) + raw[k + 1 :]
    how: dict = {}
    if chance.random() < 0.15:
        how["format"] = chance.choice([*FORMATS, None])
    if chance.random() < 0.2:
        how["axes"] = chance.choice(["x-along", "clockwise,x-left", "y-back,from-tee", "q", ""])
    if chance.random() < 0.1:
        how["stone_index"] = chance.choice([-1, 0, 1, 2, 9, 10**9])
    if chance.random() < 0.1:
        how["shot"] = chance.choice([0, 1, 2, 99])
    if chance.random() < 0.1:
        how["units"] = chance.choice(
            ["x=cm", "angle=deg,t=ms", "x=px,y=px", "x=kg", "=", "length=ft"]
        )
    return raw, how


def run_mutated(folder, seed: int, count: int) -> tuple[int, int]:
    chance = random.Random(seed)
    file, points = folder / "damaged", folder / "points.csv"
    read = refused = 0
    for k in range(count):
        raw, how = mutated(chance)
        if chance.random() < 0.2:
            spoiled = chance.random() < 0.5
            points.write_bytes(raw if spoiled else known_points().encode())
            how["reference"] = points
            if spoiled:
                raw = SAMPLES["pixels"].encode()
        file.write_bytes(raw)
        try:
            load_throw(file, **how)
        except InputError as error:
            message = str(error)
            refused += 1
        except Exception as error:
            raise AssertionError(f"seed {seed}, file {k}, {how}: {raw[:2000]!r}") from error
        else:
            message = "-"
            read += 1
        assert message, (seed, k)
        assert "\n" not in message, (seed, k)
    return read, refused


def test_damaged_files_are_read_or_refused(tmp_path):
    read, refused = run_mutated(tmp_path, 1, 500)
    assert read > 20
    assert refused > 200


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10, 20))
def test_many_damaged_files_are_read_or_refused(tmp_path, seed):
    run_mutated(tmp_path, seed, 2000)
