"""Small files of every format, and one throw to hold them against."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable
from pathlib import Path
from xml.sax.saxutils import escape
from zipfile import ZipFile

import numpy as np

from curlfit import Throw
from curlfit.findings import Finding
from curlfit.sheet import FOOT, LINES

# A throw that slows down and curls: what every file below says in its own way.
N = 60
T = np.arange(N) * 0.25
S = 1 - (1 - T / 15) ** 2
Y = 25 * S
X = -0.9 * S**2
PHI = 14 * S + 0.2
OMEGA = np.gradient(PHI, T)


def table(
    columns: dict[str, np.ndarray],
    separator: str = ",",
    digits: int = 17,
    comma: bool = False,
) -> str:
    """A text table; NaN is an empty cell (a word where spaces separate)."""
    rows = [separator.join(columns)]
    for values in zip(*columns.values(), strict=True):
        cells = [
            ("nan" if separator == " " else "") if np.isnan(v) else f"{v:.{digits}g}"
            for v in values
        ]
        rows.append(separator.join(c.replace(".", ",") if comma else c for c in cells))
    return "\n".join(rows) + "\n"


COLUMNS = {"t": T, "x": X, "y": Y, "phi": PHI}
PLAIN = table(COLUMNS)
HEADER, *ROWS = PLAIN.splitlines()


def is_throw(
    throw: Throw,
    shift: float = 0.0,
    later: float = 0.0,
    phi: bool = True,
    atol: float = 1e-9,
) -> None:
    """Assert that this is the throw above, farther to the right and
    later by so much."""
    moved = COLUMNS | {"t": T + later, "x": X + shift}
    for name, values in moved.items():
        if phi or name != "phi":
            np.testing.assert_allclose(
                getattr(throw, name), values, atol=atol, err_msg=name
            )


def note_on(throw: Throw, code: str) -> Finding:
    """The only note of a code on a throw."""
    (note,) = (note for note in throw.notes if note.code == code)
    return note


def has_note(throw: Throw, code: str) -> bool:
    """Whether there is a note of a code on a throw."""
    return any(note.code == code for note in throw.notes)


def tracker(
    separator: str = "\t", comma: bool = False, angle: str = "θ_{r} (°)"
) -> str:
    """One object, with what Tracker computes from its places, in m and degrees."""
    along = Y + 1.0
    across = X + 0.5
    vx, vy = (np.full(N, np.nan) for _ in range(2))
    vx[1:-1] = (across[2:] - across[:-2]) / (T[2:] - T[:-2])
    vy[1:-1] = (along[2:] - along[:-2]) / (T[2:] - T[:-2])
    direction = np.degrees(np.arctan2(along, across))
    body = table(
        {
            "t (s)": T,
            "x (m)": across,
            "y (m)": along,
            angle: direction,
            "v (m/s)": np.hypot(vx, vy),
        },
        separator,
        comma=comma,
    )
    return f"mass_A{separator * 4}\n{body}"


def two_masses() -> str:
    """A stone and the end of its handle, side by side, the second one marked later."""
    other = np.where(T > 1, X + 0.1, np.nan)
    head = "mass A\t\t\tmass B\t\nt\tx\ty\tx\ty\n"
    rows = zip(T, X, Y, other, np.where(T > 1, Y + 0.1, np.nan), strict=True)
    return head + "".join(
        "\t".join("" if np.isnan(v) else f"{v:.9g}" for v in row) + "\n" for row in rows
    )


def shot(end: int = 0, number: int = 0, hit: int | None = None) -> dict:
    """The entry of one shot in a server's log; stone 1 of team0 is hit in
    frame `hit`."""

    def at(x: float, y: float, angle: float) -> dict:
        return {"position": {"x": x, "y": y}, "angle": angle}

    wrapped = np.remainder(PHI + np.pi, 2 * np.pi) - np.pi
    empty: list = [None] * 8
    lying = at(0.5, 38.0, 0.0)
    start = {
        "team0": [lying, *empty[1:]],
        "team1": [at(X[0], Y[0], wrapped[0]), *empty[1:]],
    }
    frames = []
    for k in range(1, N):
        changes = [{"team": "team1", "index": 0, "value": at(X[k], Y[k], wrapped[k])}]
        if hit is not None and k >= hit:
            moved = at(0.5 + 0.01 * (k - hit + 1), 38.2, 0.1)
            changes.append({"team": "team0", "index": 0, "value": moved})
        frames.append(changes)
    return {
        "tag": "sht",
        "id": number,
        "date_time": "2022-01-01T00:00:00",
        "thread": "1",
        "log": {
            "game_id": "g",
            "end": end,
            "shot": number,
            "selected_move": {"type": "shot"},
            "actual_move": {"type": "shot"},
            "trajectory": {
                "seconds_per_frame": 0.25,
                "start": start,
                "finish": start,
                "frames": frames,
            },
        },
    }


def log(count: int = 1) -> str:
    """A server's log with some shots among other lines."""
    other = {"tag": "inf", "id": 0, "log": "server started"}
    entries = [other, *(shot(0, k) for k in range(count))]
    return "".join(json.dumps(entry) + "\n" for entry in entries)


def video() -> dict:
    """An answer of curling-stone-tracker, in feet from the centre of the sheet: the
    throw above in two pieces, 10 m from the hack and 1 m to the right, of which the
    first is followed by two rows of the tracker's own, and a stone at rest."""
    positions = np.column_stack([X + 1.0, Y + 10.0 - LINES["centre"]]) / FOOT
    early = T <= 2.5
    late = T >= 6
    last = {"t": [2.75, 3.0], "place": [[3.3, -30.0], [3.3, -28.0]]}
    return {
        "state": {
            "stones": [
                tracked("red", T[late], positions[late].tolist()),
                tracked("yellow", T, [[-2.0, 57.5]] * N),
                tracked(
                    "red",
                    [*T[early], *last["t"]],
                    [*positions[early].tolist(), *last["place"]],
                    made=2,
                ),
            ]
        },
        "mosaic_detections": [],
        "mosaic_detection_times": [],
    }


def tracked(color: str, times: Iterable[float], places: list, made: int = 0) -> dict:
    """A stone as curling-stone-tracker writes it; the last rows have `made`
    accelerations that are those of the row before."""
    times = [float(time) for time in times]
    measured_rows = len(times) - made
    return {
        "acceleration_history": [
            [0.0, -0.01 * min(k, measured_rows - 1)] for k in range(len(times))
        ],
        "color": color,
        "position_history": places,
        "time_history": times,
        "velocity_history": [[0.0, 0.0] for _ in times],
    }


TIMINGS = """# draw shot, sheet 3
back_to_hog = 3.4
hog_to_hog = 14.2 s
hog_to_rest = 10.3
curl = -4 ft
rest = 0.6
turns = 2.5
sigma_t = 0.1
"""

CLOCKS = "t,x,y,t_phi,phi\n" + "".join(
    f"{0.5 * k},{0.01 * k},{k - 0.02 * k * k},{0.5 * k + 0.1},{0.3 * k}\n"
    for k in range(12)
)

# A camera that looks along the sheet.
CAMERA = np.array([[40.0, 3.0, 320.0], [1.0, -4.0, 460.0], [0.001, 0.03, 1.0]])
KNOWN = np.array([[-2.1, 2.1, -2.0, 2.2, 0.0, 1.0], [0.0, 0.5, 27.0, 26.0, 12.0, 20.0]])


def project(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Pixels u, v of places on the ice."""
    u, v, w = CAMERA @ np.stack([x, y, np.ones_like(x)])
    return np.stack([u / w, v / w])


def known_points(count: int = 6, noise: float = 0.0) -> str:
    """A table of known points for the camera."""
    pixels = project(*KNOWN) + noise * np.random.default_rng(3).normal(size=KNOWN.shape)
    return table(
        {
            "u": pixels[0, :count],
            "v": pixels[1, :count],
            "x": KNOWN[0, :count],
            "y": KNOWN[1, :count],
        }
    )


PIXELS = table(dict(zip("uv", project(X, Y), strict=True)) | {"t": T, "phi": PHI})

EVENING = (
    "Club night;;;;;\n"
    "draw;time;sheet;hog to hog;rest;curl\n"
    ";;;(s);;\n"
    "1;7:05 pm;A;12,86;1'7\" heavy;3 ft left\n"
    "2;7:12 pm;B;0:12.18;0.4 m light;2 ft right\n"
    "3;7:19 pm;A;DNF;0.2;1 m left\n"
    "4;7:25 pm;B;12,7;0.5 m past;0.8 m right\n"
    "Mean;;;12,6;;\n"
)
SAMPLES = {
    "table": PLAIN,
    "settings": '# until = 12\n# stone.R = 0.06\n# axes = "x-left"\n' + PLAIN,
    "semicolons": table(
        {
            "time_ms": 1000 * T,
            "y (ft)": Y / 0.3048,
            "x [cm]": 100 * X,
            "angle_deg": np.degrees(PHI) % 360,
        },
        ";",
        comma=True,
    ),
    "tracker": tracker(),
    "two": two_masses(),
    "shot": json.dumps(shot(hit=40), indent=1),
    "log": log(2),
    "video": json.dumps(video(), indent=1),
    "timings": TIMINGS,
    "evening": EVENING,
    "friction": "v (m/s),mu,omega\n0.5,0.011,0\n1,0.0095,0\n2,0.009,0\n3,0.008,0\n",
    "clocks": CLOCKS,
    "pixels": PIXELS,
}


_ARM = 0.1  # m, from the stone's centre to a mark on its handle


def marked_stone() -> dict[str, np.ndarray]:
    """Places of the stone and of a mark on its handle, in m."""
    return {
        "x": X,
        "y": Y,
        "x_mark": X + _ARM * np.cos(PHI),
        "y_mark": Y + _ARM * np.sin(PHI),
    }


def rows_of(*columns: np.ndarray, first: int = 0, digits: int = 9) -> str:
    """Rows of a number that counts on from `first`, and of columns; NaN is an empty
    cell."""
    rows = []
    for number, values in enumerate(zip(*columns, strict=True), first):
        cells = ["" if np.isnan(value) else f"{value:.{digits}g}" for value in values]
        rows.append(",".join([str(number), *cells]) + "\n")
    return "".join(rows)


def vicon(rate: str = "4", places: dict[str, np.ndarray] | None = None) -> str:
    """The ASCII export of Nexus, with a section of a force plate above the markers and
    one of events below them."""
    marks = [1000 * values for values in (places or marked_stone()).values()]
    height = np.full(N, 110.0)
    rows = rows_of(np.zeros(N), *marks[:2], height, *marks[2:], height, first=1)
    return (
        "Devices\n1000\n,,Force plate\nFrame,Sub Frame,Fx\n,,N\n"
        "1,0,0.5\n1,1,0.4\n\n"
        f"Trajectories\n{rate}\n,,stone:centre,,,stone:handle,,\n"
        "Frame,Sub Frame,X,Y,Z,X,Y,Z\n,,mm,mm,mm,mm,mm,mm\n"
        f"{rows}\nEvents\n4\nSubject,Context,Name\n"
    )


def optitrack(
    columns: dict[str, np.ndarray] | None = None,
    quaternion: np.ndarray | None = None,
    unit: str = "Millimeters",
) -> str:
    """The CSV export of Motive: a rigid body, whose mean marker error has no heading,
    and a marker.

    Parameters
    ----------
    columns : X, Y, Z of the body and of the marker in mm; by default x along the sheet,
        y up. quaternion : X, Y, Z, W, shape (n, 4); by default turned by the angle
        about y.
    """
    if quaternion is None:
        zero = np.zeros(N)
        half = PHI / 2
        quaternion = np.column_stack([zero, np.sin(half), zero, np.cos(half)])
    if columns is None:
        stone, handle = np.split(np.array(list(marked_stone().values())), 2)
        height = np.full(N, 0.11)
        coordinates = [stone[1], height, stone[0], handle[1], height, handle[0]]
        names = ["X", "Y", "Z", "X handle", "Y handle", "Z handle"]
        columns = {
            name: 1000 * coordinate
            for name, coordinate in zip(names, coordinates, strict=True)
        }
    error = np.full(N, 0.2)
    body, marker = np.split(np.array(list(columns.values())), 2)
    rows = rows_of(T, *quaternion.T, *body, error, *marker)
    types = ",".join(["Rigid Body"] * 8)
    return (
        "Format Version,1.23,Take Name,evening,Capture Frame Rate,4.000000,Export "
        f"Frame Rate,4.000000,Rotation Type,Quaternion,Length Units,{unit},"
        "Coordinate Space,Global\n\n"
        f",Type,{types},Marker,Marker,Marker\n"
        f",Name,{','.join(['Stone'] * 8)},Stone:Handle,Stone:Handle,Stone:Handle\n"
        f",ID,{','.join(['A1'] * 8)},B2,B2,B2\n"
        f",,{','.join(['Rotation'] * 4 + ['Position'] * 3)},Mean Marker Error,"
        "Position,Position,Position\n"
        f"Frame,Time (Seconds),X,Y,Z,W,X,Y,Z,,X,Y,Z\n{rows}"
    )


def vernier(data_sets: Iterable[str] = ("VideoAnalysis",), space: str = " ") -> str:
    """A CSV export of Vernier's programs, each data set 0.5 m farther to the right."""
    columns = {}
    for number, name in enumerate(data_sets):
        measured = {
            "Time": ("s", T),
            "X": ("m", X + 0.5 * number),
            "Y": ("m", Y),
            "Y Velocity": ("m/s", np.gradient(Y, T)),
        }
        for quantity, (unit, values) in measured.items():
            columns[f"{name}:{space}{quantity}{space}({unit})"] = values
    return table(columns, digits=9)


CASES = Path(__file__).parent / "throws" / "cases"
EXPORTS = {
    "deeplabcut": (CASES / "16_deeplabcut.csv").read_text(),
    "optitrack": optitrack(),
    "qualisys": (CASES / "22_qualisys.tsv").read_text(),
    "trackmate": (CASES / "16_trackmate.csv").read_text(),
    "vernier": vernier(),
    "vicon": vicon(),
}
"""Tables that other programs export, each named after its layout."""

CELL = (
    '<table:table-cell office:value-type="{}" {}><text:p>{}</text:p></table:table-cell>'
)
SHEETS = (
    "<office:document-content "
    'xmlns:office="urn:oasis:names:tc:opendocument:xmlns:office:1.0" '
    'xmlns:table="urn:oasis:names:tc:opendocument:xmlns:table:1.0" '
    'xmlns:text="urn:oasis:names:tc:opendocument:xmlns:text:1.0"><office:body>'
    '<office:spreadsheet><table:table table:name="empty"/>{}'
    "</office:spreadsheet></office:body></office:document-content>"
)


def ods(file: Path, rows: Iterable[str], **others: Iterable[str]) -> Path:
    """A workbook: an empty worksheet, one named `evening` with these rows, each the
    text of its cells, and others."""
    tables = {
        name: "".join(f"<table:table-row>{row}</table:table-row>" for row in worksheet)
        for name, worksheet in {"evening": rows, **others}.items()
    }
    sheets = (
        f'<table:table table:name="{k}">{v}</table:table>' for k, v in tables.items()
    )
    with ZipFile(file, "w") as archive:
        archive.writestr("mimetype", "application/vnd.oasis.opendocument.spreadsheet")
        archive.writestr("content.xml", SHEETS.format("".join(sheets)))
        archive.writestr("META-INF/manifest.xml", "<manifest/>")
    return file


_SHEET = (
    '<worksheet xmlns="http://schemas.openxmlformats.org/spreadsheetml/2006/main">'
    "<sheetData>{}</sheetData></worksheet>"
)
_RELATIONS = "http://schemas.openxmlformats.org/officeDocument/2006/relationships"


def xlsx(file: Path, *worksheets: str) -> Path:
    """A workbook with these worksheets, each the XML of its rows."""
    names = range(1, len(worksheets) + 1)
    sheets = "".join(f'<sheet name="s{k}" sheetId="{k}" r:id="r{k}"/>' for k in names)
    relations = "".join(
        f'<Relationship Id="r{k}" Type="{_RELATIONS}/worksheet" '
        f'Target="worksheets/sheet{k}.xml"/>'
        for k in names
    )
    book = (
        f'<Relationship Type="{_RELATIONS}/officeDocument" Target="xl/workbook.xml"/>'
    )
    with ZipFile(file, "w") as archive:
        archive.writestr("_rels/.rels", f"<Relationships>{book}</Relationships>")
        archive.writestr(
            "xl/workbook.xml",
            f'<workbook xmlns:r="{_RELATIONS}"><sheets>{sheets}</sheets></workbook>',
        )
        archive.writestr(
            "xl/_rels/workbook.xml.rels", f"<Relationships>{relations}</Relationships>"
        )
        for k, rows in zip(names, worksheets, strict=True):
            archive.writestr(f"xl/worksheets/sheet{k}.xml", _SHEET.format(rows))
    return file


def xlsx_rows(text: str, separator: str = ",") -> str:
    """The rows of a table as the XML of a worksheet."""
    rows = []
    for line in text.splitlines():
        cells = [
            f"<c><v>{cell}</v></c>"
            if re.fullmatch(r"[-+.\de]+", cell)
            else f'<c t="inlineStr"><is><t>{escape(cell)}</t></is></c>'
            for cell in line.split(separator)
        ]
        rows.append(f"<row>{''.join(cells)}</row>")
    return "".join(rows)
