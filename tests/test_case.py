"""Case files: what is read, and what every kind of bad input is answered with."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qbxstokes.case.describe import SCHEMA_FILE, json_schema, keys_page, starter
from qbxstokes.case.document import MAX_BYTES, parse
from qbxstokes.case.load import load_case, validate
from qbxstokes.case.schema import Case, keys
from qbxstokes.case.values import expression, to_angle
from qbxstokes.errors import CaseError

WriteCase = Callable[..., Path]

GOOD = """\
body:
  aspect_ratio: 0.5
flow: {type: shear, rate: 1.0}
start:
  orientation: {euler: {phi: 30 deg, theta: pi/2}}
time:
  periods: 3
  tolerance: 1e-6
"""


def case_of(text: str) -> Case:
    return validate(parse(text, "case.yaml"))


def test_good_case_and_its_defaults() -> None:
    case = case_of(GOOD)
    assert case.task == "motion"
    assert case.body.stokes_number == 0.0
    assert case.time is not None
    assert case.time.tolerance == 1e-6  # a string for YAML 1.1
    assert case.time.periods == 3.0
    euler = case.start.orientation.euler
    assert euler is not None
    assert euler.phi == pytest.approx(math.pi / 6, rel=1e-15)
    assert euler.theta == math.pi / 2
    assert case.flow.spec() == {"type": "shear", "rate": 1.0}
    assert case.petsc == {}


def outcome(text: str) -> str:
    """The message for a bad case, '' for a good one; anything but CaseError passes through."""
    try:
        case_of(text)
    except CaseError as error:
        return str(error)
    return ""


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *[("1e-6", 1e-6), ("1E6", 1e6), (".5", 0.5), ("5.", 5.0), ("+7", 7.0), ("1/50", 0.02)],
        *[
            ("2*pi", 2 * math.pi),
            ("sqrt(4)/2", 1.0),
            ("-1.5e+3", None),
            ("1:30", None),
            ("on", None),
        ],
    ],
)
def test_numbers_as_people_write_them(text: str, value: float | None) -> None:
    document = parse(GOOD.replace("0.5\n", f"{text}\n"), "case.yaml")
    if value is None:
        with pytest.raises(CaseError, match=r"case.yaml:2: body.aspect_ratio"):
            validate(document)
    else:
        assert validate(document).body.aspect_ratio == value


@pytest.mark.parametrize(
    ("text", "angle"),
    [
        *[("90 deg", math.pi / 2), ("90°", math.pi / 2), ("pi/2", math.pi / 2), (1, 1.0)],
        *[("0.25 rad", 0.25), ("-pi/3 rad", -math.pi / 3), ("360/7 degrees", 2 * math.pi / 7)],
    ],
)
def test_angles(text: Any, angle: float) -> None:
    assert to_angle(text) == pytest.approx(angle, rel=1e-15)


@pytest.mark.parametrize("text", ["9**9**9**9", "x", "__import__('os')", "1/0", "(" * 70, "", "1j"])
def test_arithmetic_is_only_arithmetic(text: str) -> None:
    with pytest.raises(ValueError, match=r"arithmetic|syntax|zero|range|long|EOF|closed"):
        expression(text)


# What is replaced in GOOD, by what, and what the message must hold.
FAULTS = {
    "zero aspect ratio": ("0.5\n", "0\n", r":2: body.aspect_ratio: is 0; must be > 0"),
    "negative aspect ratio": ("0.5\n", "-1\n", r":2: body.aspect_ratio: is -1; must be > 0"),
    "nan": ("0.5\n", ".nan\n", r":2: body.aspect_ratio: .*not finite"),
    "infinite": ("0.5\n", "1e999\n", r":2: body.aspect_ratio: .*not finite"),
    "boolean": ("0.5\n", "true\n", r":2: body.aspect_ratio: is true; a number"),
    "long integer": ("0.5\n", "9" * 5000 + "\n", r":2: body.aspect_ratio: .*not a number"),
    "list": ("0.5\n", "[1, 2]\n", r":2: body.aspect_ratio: is a list"),
    "missing": ("  aspect_ratio: 0.5\n", "  {}\n", r":1: body.aspect_ratio: is missing; .*0.5"),
    "negative Stokes": ("0.5\n", "0.5\n  stokes_number: -1\n", r":3: body.stokes_number: is -1"),
    "unknown key": ("aspect_ratio", "aspect_ration", r":2: body.aspect_ration: .*aspect_ratio\?"),
    "unknown section": ("body", "boddy", r":1: boddy: unknown key; did you mean body\?"),
    "duplicate key": ("0.5\n", "0.5\n  aspect_ratio: 2\n", r":3: aspect_ratio: .*line 2"),
    "section as number": ("\n  aspect_ratio: 0.5", " 3", r":1: body: is 3; keys are expected"),
    "zero quaternion": ("{euler: {phi: 30 deg, theta: pi/2}}", "{quaternion: [0, 0, 0, 0]}",
                        r":5: start.orientation.quaternion: is zero"),
    "short vector": ("{euler: {phi: 30 deg, theta: pi/2}}", "{axis: [0, 1]}",
                     r":5: start.orientation.axis: has 2 entries"),
    "word in vector": ("{euler: {phi: 30 deg, theta: pi/2}}", "{axis: [0, 1, up]}",
                       r":5: start.orientation.axis\[2\]: 'up' is not a number"),
    "two orientations": ("{euler: {", "{axis: [0, 0, 1], euler: {", r":5: .*axis; give exactly one"
                         r"|:5: start.orientation: gives euler and axis"),
    "bad angle": ("30 deg", "30 degs", r":5: start.orientation.euler.phi: .*not an angle"),
    "velocity of massless": ("start:\n", "start:\n  velocity: [1, 0, 0]\n",
                             r":5: start.velocity: has no meaning for a massless"),
    "no end": ("  periods: 3\n", "", r":6: time: does not say when to end"),
    "two ends": ("periods: 3\n", "periods: 3\n  end: 2\n", r":6: time: gives end and periods"),
    "end in the past": ("periods: 3", "end: -1", r":7: time.end: is -1; must be > 0"),
    "falling instants": ("periods: 3", "at: [0, 2, 1]", r":7: time.at\[2\]: 1 does not follow 2"),
    "half a sample": ("periods: 3", "periods: 3\n  samples: 2.5", r":8: time.samples: 2.5 is not"),
    "zero tolerance": ("1e-6", "0", r":8: time.tolerance: is 0; must be > 0"),
    "unknown choice": ("start:", "hydrodynamics: {solve: everystep}\nstart:",
                       r":4: hydrodynamics.solve: .*did you mean every_step\?"),
    "forbidden radius": ("start:", "hydrodynamics: {scheme: uniform, n_theta: 20, n_phi: 20, "
                         "expansion_order: 8, upsampling: 4, r_over_h: 2}\nstart:",
                         r":4: hydrodynamics.r_over_h: .*r <= 0.25 of the .*r_over_h <= 0.79"),
    "uniform without numbers": ("start:", "hydrodynamics: {scheme: uniform}\nstart:",
                                r":4: hydrodynamics.n_theta: is missing"),
    "foreign scheme": ("start:", "hydrodynamics: {upsampling: 4}\nstart:",
                       r":4: hydrodynamics.upsampling: .*scheme: graded"),
    "nested option": ("start:", "petsc: {ts_type: [rk]}\nstart:", r":4: petsc.ts_type: is a list"),
    "unknown flow": ("type: shear", "type: sheer", r":3: flow.*did you mean shear\?"),
    "unknown flow key": ("rate: 1.0", "rat: 1.0", r":3: flow.*did you mean rate\?"),
    "trace": ("type: shear, rate: 1.0", "type: linear, gradient: [[1, 0, 0], [0, 0, 0], [0, 0, 0]]",
              r":3: flow.*trace 1"),
    "python tag": ("0.5\n", "!!python/name:os.system\n", r":2: tag .* not allowed"),
    "syntax": ("flow: {type", "flow: {{type", r":\d+: "),
    "second document": ("start:", "---\nstart:", r":4: a second document"),
    "unknown alias": ("0.5\n", "*k\n", r":2: "),
    "no bodies": ("body:", "bodies: []\nbody:", r":1: bodies: holds 0 bodies; 1 to"),
    "bodies and a body": ("body:", "bodies: [{aspect_ratio: 1}]\nbody:", r":2: body: .*give it in"),
    "no wall": ("start:", "surroundings: {type: wal}\nstart:", r":4: surroundings.type: .*wall"),
    "a suspension": ("start:", "rheology: {}\nstart:", r":4: rheology: .*task: rheology"),
    "an ensemble": ("start:", "statistics: {}\nstart:", r":4: statistics: .*sweep.store"),
    "two shapes": ("0.5\n", "0.5\n  shape: {type: spheroid, aspect_ratio: 1}\n",
                   r":1: body: gives aspect_ratio and shape; exactly one"),
    "another shape": ("  aspect_ratio: 0.5\n", "  shape: {type: spheroidal, aspect_ratio: 1}\n",
                      r":2: body.shape.type: is 'spheroidal'; did you mean spheroid"),
    "a number of the shape": ("  aspect_ratio: 0.5\n", "  shape: {type: spheroid, k: 1}\n",
                              r":2: body.shape.k: is no key of this shape; .*aspect_ratio"),
    "shape without type": ("  aspect_ratio: 0.5\n", "  shape: {aspect_ratio: 1}\n",
                           r":2: body.shape.type: is missing"),
    "benchmark": ("start:", "task: benchmark\nstart:", r":4: task: .*cases/benchmarks"),
    "stress": ("start:", "task: stress\nstart:", r":4: task: .*tests/stress"),
    "study": ("start:", "task: study\nstart:", r":4: task: .*cases/studies"),
    "tables": ("start:", "study: {size: small}\nstart:", r":4: study: .*cases/studies"),
    "two faults": ("0.5\n", "0\n  stokes_number: -1\n", r":2: .*\(and 1 more fault after it\)"),
}  # fmt: skip


@pytest.mark.parametrize("name", FAULTS)
def test_faults_are_named_with_file_line_and_key(name: str, write_case: WriteCase) -> None:
    old, new, expected = FAULTS[name]
    assert old in GOOD
    path = write_case(GOOD.replace(old, new, 1))
    with pytest.raises(CaseError, match=expected) as caught:
        load_case(path)
    message = str(caught.value)
    assert message.startswith(f"{path}:")
    assert "\n" not in message


@pytest.mark.parametrize(
    ("raw", "expected"),
    [
        (b"", ":1: is empty"),
        (b"# only a comment\n", ":1: is empty"),
        (b"- a\n- b\n", "not a set of keys"),
        (b"\xff\xfeb\0o\0d\0y\0", "UTF-16"),
        ("body: ä".encode("latin-1"), "not UTF-8"),
        (b"\x89HDF\r\n\x1a\n1234", "HDF5"),
        (b"body: \0", "zero bytes"),
        (b"[" * 200_000, "nested more than"),
        (b"{a: " * 200_000, "nested more than"),
        (b"- " * 200_000, "nested more than"),
        (b"a: &a [*a]", "within &a itself"),
        (b"? [1, 2]\n: 3", "single word"),
        (b"a: " + b"x" * MAX_BYTES, "longer than"),
        (b"\x07: 1", "not valid YAML"),
        (b"%YAML 3.0\n---\na: 1", ": "),
        (
            b"a: &a [1,1,1,1,1,1,1,1,1,1]\n"
            + b"".join(
                b"%c: &%c [%s]\n" % (n, n, b",".join([b"*%c" % (n - 1)] * 10))
                for n in range(ord("b"), ord("z"))
            ),
            "more than",
        ),
    ],
)  # fmt: skip
def test_files_that_are_no_case(raw: bytes, expected: str, tmp_path: Path) -> None:
    path = tmp_path / "case.yaml"
    path.write_bytes(raw)
    with pytest.raises(CaseError, match=expected):
        load_case(path)


def test_paths_that_are_no_file(tmp_path: Path) -> None:
    with pytest.raises(CaseError, match="is a directory"):
        load_case(tmp_path)
    with pytest.raises(CaseError, match="no such file"):
        load_case(tmp_path / "missing.yaml")
    with pytest.raises(CaseError, match="cannot be read"):
        load_case(tmp_path / ("x" * 5000))
    with pytest.raises(CaseError, match="no such file"):
        load_case(tmp_path / "nul\0byte")


def test_overrides(write_case: WriteCase) -> None:
    path = write_case(GOOD)
    loaded = load_case(path, ["body.aspect_ratio=1e-1", "flow.rate=2", "output.file=x.h5"])
    assert loaded.case.body.aspect_ratio == 0.1
    assert loaded.case.flow.spec()["rate"] == 2
    assert loaded.case.output.file == "x.h5"
    loaded = load_case(path, ["start.position=[1, 2, 3]", "start.position[1]=7"])
    assert loaded.case.start.position == (1.0, 7.0, 3.0)
    assert load_case(path, ["start.position[1]=7"]).case.start.position == (0.0, 7.0, 0.0)
    loaded = load_case(path, ["time.at=[0, 1]", "body.length_over_diameter=4"])  # and no others
    assert loaded.case.time.at == (0.0, 1.0)
    assert loaded.case.body.aspect_ratio is None


@pytest.mark.parametrize(
    ("override", "expected"),
    [
        ("body.aspect_ratio=-1", "--set body.aspect_ratio=-1: body.aspect_ratio: is -1; must be"),
        ("body.aspect_ratio", "not an assignment"),
        ("=1", "not an assignment"),
        ("body.aspect_ratio.x=1", "is not a section"),
        ("bdy.aspect_ratio=1", "--set bdy.aspect_ratio=1: bdy: unknown key; did you mean body?"),
        ("start.position[7]=1", "start.position is a list of 3 entries"),
        ("start.orientation.axis[x]=1", "start.orientation"),
        ("body=[", "not valid YAML"),
        ("time={end:3}", "end:3: has no value; put a space after the colon"),
        ("flow.rate=2 1/s", "numbers with units need the section `units`"),
    ],
)
def test_bad_overrides(override: str, expected: str, write_case: WriteCase) -> None:
    with pytest.raises(CaseError) as caught:
        load_case(write_case(GOOD), [override])
    assert expected in str(caught.value)


def test_arithmetic_and_angles_in_a_flow() -> None:
    text = GOOD.replace("rate: 1.0", "rate: 1/6, rotation: {axis: [0, 0, 1], angle: 90 deg}")
    spec = case_of(text).flow.spec()
    assert spec["rate"] == 1 / 6
    assert spec["rotation"]["angle"] == math.pi / 2


def test_anchors_and_empty_sections_work(write_case: WriteCase) -> None:
    text = GOOD + "hydrodynamics:\n  # tolerance: 1e-8\noutput: {fields: &f [axis]}\n"
    case = load_case(write_case(text)).case
    assert case.hydrodynamics.tolerance == 1e-10
    assert case.output.fields == ("axis",)


def test_unions_and_defaults_survive_a_round_trip(write_case: WriteCase) -> None:
    loaded = load_case(write_case(GOOD + "petsc: {ts_type: rk, -ts_monitor: }\n"))
    again = case_of(json.dumps(loaded.resolved()))
    assert again == loaded.case
    assert again.petsc == {"ts_type": "rk", "ts_monitor": None}


def test_every_key_is_described() -> None:
    page = keys_page()
    for name, field in keys():
        assert field.meaning, name
        assert f"\n{name}" in page


def test_starter_case_runs_as_it_is() -> None:
    case = case_of(starter())
    assert case.time is not None
    assert case.time.periods == 3.0


def test_schema_file_is_current() -> None:
    stored = resources.files("qbxstokes.case").joinpath(SCHEMA_FILE).read_text()
    assert json.loads(stored) == json_schema(), "run: python -m qbxstokes schema --write"


@settings(max_examples=200, deadline=None)
@given(
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=8),
        lambda inner: (
            st.lists(inner, max_size=4)
            | st.dictionaries(
                st.sampled_from([name.split(".")[-1] for name, _ in keys()]) | st.text(max_size=5),
                inner,
                max_size=5,
            )
        ),
        max_leaves=25,
    )
)
def test_random_data_is_refused_in_one_line(data: Any) -> None:
    text = json.dumps(data).replace("Infinity", ".inf").replace("NaN", ".nan")
    assert outcome(text).isprintable()


@settings(max_examples=200, deadline=None)
@given(st.data())
def test_random_edits_of_a_good_case_end_in_one_line(data: st.DataObject) -> None:
    start = data.draw(st.integers(0, len(GOOD)))
    length = data.draw(st.integers(0, 12))
    inserted = data.draw(st.text(max_size=6) | st.sampled_from(["\n", ": ", "{", "]", "- ", "&a "]))
    assert outcome(GOOD[:start] + inserted + GOOD[start + length :]).isprintable()
