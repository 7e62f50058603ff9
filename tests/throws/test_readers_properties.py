"""Generated files: the same throw in every guise."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import HealthCheck, given, settings, strategies as st
from sample_files import OMEGA, PHI, N, T, X, Y, table

from curlfit import load_throw

UNITS = {
    "t": {
        "t": 1.0,
        "time_s": 1.0,
        "Time [ms]": 1e-3,
        "t_min": 60.0,
        "elapsed (s)": 1.0,
    },
    "x": {
        "x": 1.0,
        "x_cm": 0.01,
        "pos_x (mm)": 1e-3,
        "X [ft]": 0.3048,
        "x (in)": 0.0254,
    },
    "y": {"y": 1.0, "y_ft": 0.3048, "y-position (m)": 1.0, "ypos_yd": 0.9144},
    "phi": {
        "phi": 1.0,
        "angle_deg": math.pi / 180,
        "θ (°)": math.pi / 180,
        "rotation [rev]": 2 * math.pi,
        "theta_rad": 1.0,
    },
    "omega": {
        "omega": 1.0,
        "spin_rpm": math.pi / 30,
        "gyro (deg/s)": math.pi / 180,
        "ω (rad/s)": 1.0,
    },
}
WANTED = {"t": T, "x": X, "y": Y, "phi": PHI, "omega": OMEGA}


@given(data=st.data())
@settings(
    max_examples=120,
    deadline=None,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)
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
    order = draw(
        st.permutations([n for n in WANTED if n != "omega" or draw(st.booleans())])
    )
    wrap = draw(st.sampled_from([None, (0.0, 2 * math.pi), (-math.pi, 2 * math.pi)]))
    gaps = draw(
        st.lists(
            st.tuples(st.sampled_from(["x", "y", "phi"]), st.integers(0, N - 1)),
            max_size=12,
        )
    )
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
        np.testing.assert_allclose(
            getattr(throw, name), expected[name], rtol=1e-9, atol=1e-9
        )
    measured = np.isfinite(expected["phi"])
    np.testing.assert_array_equal(np.isfinite(throw.phi), measured)
    off = (throw.phi - expected["phi"])[measured]
    # the zero of a wrapped angle is lost
    np.testing.assert_allclose(off, off[0], atol=1e-9)
    if not wrap:
        assert abs(off[0]) < 1e-9
    if "omega" in order:
        np.testing.assert_allclose(throw.omega, OMEGA, rtol=1e-9, atol=1e-9)
