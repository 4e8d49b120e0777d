"""Bad input, by the hundreds: one clear line, exit status 2, nothing written, nothing run.

A corpus built from the schema (every key times every wrong value), a corpus of files that are no
case, random edits of the cases in `cases/` with a fixed seed, and hypothesis. Everything goes
through the command line's `main` in this process; a handful goes through real processes.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import random
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from conftest import ENVIRONMENT
from hypothesis import given, settings
from hypothesis import strategies as st

from qbxstokes.__main__ import main
from qbxstokes.case.schema import keys
from qbxstokes.cli import main as cli
from qbxstokes.flows import REGISTRY
from qbxstokes.io.writer import ResultWriter

CASES = sorted((Path(__file__).parents[1] / "cases").glob("*.yaml"))
LONGEST = 2.0  # seconds of processor time that looking at one case may take
GOOD: dict[str, Any] = {
    "body": {"aspect_ratio": 0.5},
    "flow": {"type": "shear"},
    "time": {"periods": 1, "samples": 11},
}


@dataclass
class Outcome:
    """What a command line left behind."""

    status: int
    out: str
    err: str

    @property
    def refused(self) -> bool:
        """One clear line on standard error, status 2, nothing else said."""
        self.check_tidy()
        return self.status == 2

    def check_tidy(self) -> None:
        """Success without complaint, or one printable line and status 2."""
        if self.status == 0:
            assert self.err == ""
            return
        assert self.status == 2, self
        assert self.err.endswith("\n")
        line = self.err.removesuffix("\n")
        assert line.isprintable(), repr(line)
        assert 10 < len(line) < 2500
        assert "Traceback" not in line


def command(*words: str) -> Outcome:
    """Run the command line in this process; no longer than LONGEST."""
    out, err = io.StringIO(), io.StringIO()
    begin = time.process_time()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(words)
    assert time.process_time() - begin < LONGEST
    return Outcome(status, out.getvalue(), err.getvalue())


@pytest.fixture(scope="module", autouse=True)
def empty_folder(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """All runs of this module happen here; at the end there is only what the tests put there."""
    folder = tmp_path_factory.mktemp("bad_input")
    before = Path.cwd()
    os.chdir(folder)
    path = Path("case.yaml")
    path.write_text(json.dumps(GOOD))
    assert command("check", "case.yaml").status == 0
    yield folder
    path.unlink()
    os.chdir(before)
    assert [file.name for file in folder.iterdir()] == []


def judge(content: bytes | str, *words: str) -> Outcome:
    """What `check` says of a case file with this content."""
    path = Path("case.yaml")
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    outcome = command("check", "case.yaml", *words)
    outcome.check_tidy()
    assert [file.name for file in Path().iterdir()] == ["case.yaml"]
    if outcome.status:
        assert outcome.out == ""
        assert outcome.err.startswith(("case.yaml:", "--set "))
    return outcome


# -- every key of the schema times every wrong value ----------------------------------------

WRONG: dict[str, Any] = {
    "null": None, "true": True, "text": "abc", "empty text": "", "list": [], "mapping": {"a": 1},
    "list of lists": [[1]], "nan": ".nan", "infinity": "-.inf", "beyond double": "1e999",
    "many digits": "9" * 400, "minus one": -1, "half": 0.5, "huge": 1e300, "tiny": 1e-300,
    "complex": "1+2j", "call": "__import__('os').system('true')", "power tower": "9**9**9",
    "long text": "x" * 5000, "control": "a\x1b[2Jb", "zero byte": "a\0b", "path": "../../../etc",
    "date": "2020-01-01", "hexadecimal": "0x10", "sexagesimal": "1:30", "unicode": "\u202e½",
    "short vector": [1, 2], "long vector": [1, 2, 3, 4, 5], "vector of texts": ["a", "b", "c"],
    "vector with nan": [0, ".nan", 1], "vector of nulls": [None, None, None],
}  # fmt: skip
KEYS = dict(keys())


def with_key(name: str, value: Any) -> dict[str, Any]:
    """The good case with one key set."""
    case = json.loads(json.dumps(GOOD))
    holder = case
    *sections, last = name.split(".")
    for section in sections:
        holder = holder.setdefault(section, {})
    holder[last] = value
    return case


@pytest.mark.parametrize("name", KEYS)
def test_every_key_refuses_what_it_cannot_use(name: str) -> None:
    plain = KEYS[name].reader.section is None and name not in ("petsc", "task")
    is_text = judge(json.dumps(with_key(name, "abc"))).status == 0
    for wrong, value in WRONG.items():
        outcome = judge(json.dumps(with_key(name, value)))
        if outcome.refused:
            assert outcome.err.startswith("case.yaml:1:")
        if plain and wrong in ("mapping", "list of lists", "zero byte"):
            assert outcome.refused, (wrong, outcome)
        if plain and not is_text and wrong in ("nan", "call", "beyond double"):
            assert outcome.refused, (wrong, outcome)


@pytest.mark.parametrize("name", [name for name in KEYS if name not in ("title", "petsc")])
def test_every_key_is_missed_when_misspelt_and_refused_twice(name: str) -> None:
    misspelt = name[:-1] + "q" if name != "task" else "tusk"
    outcome = judge(json.dumps(with_key(misspelt, 1)))
    assert outcome.refused, name
    *sections, last = name.split(".")
    opening = "".join(f"{{{section}: " for section in sections)
    twice = f"{opening}{{{last}: 1, {last}: 2}}" + "}" * len(sections)
    assert "given twice" in judge(twice).err


@pytest.mark.parametrize("flow", REGISTRY)
def test_every_flow_refuses_wrong_arguments(flow: str) -> None:
    for key in [*REGISTRY[flow].keys(), "position", "rotation", "nonsense"]:
        for wrong, value in WRONG.items():
            case = GOOD | {"flow": {"type": flow, key: value}}
            outcome = judge(json.dumps(case))
            if wrong == "mapping" or key == "nonsense":
                assert outcome.refused, (key, wrong)


# -- files that are no case -----------------------------------------------------------------

BOMB = "a: &a [1,1,1,1,1,1,1,1,1,1]\n" + "".join(
    f"{chr(n)}: &{chr(n)} [{','.join([f'*{chr(n - 1)}'] * 10)}]\n" for n in range(98, 122)
)
FILES: dict[str, bytes] = {
    "empty": b"", "blank": b"\n\n  \n", "comment": b"# nothing\n", "null": b"null\n",
    "number": b"3\n", "text": b"hello\n", "list": b"- 1\n- 2\n", "markers": b"---\n...\n",
    "two documents": b"body: {}\n---\nbody: {}\n", "utf-16": "body: {}".encode("utf-16"),
    "utf-32": "body: {}".encode("utf-32"), "latin-1": "title: sphéroïde".encode("latin-1"),
    "utf-8 with mark": "\ufeffbody: 3\n".encode(), "overlong utf-8": b"title: \xc0\xaf",
    "surrogate": b"title: \xed\xa0\x80", "cut utf-8": b"title: \xe2\x82",
    "zero bytes": b"\0" * 1000, "png": b"\x89PNG\r\n\x1a\n" + bytes(range(256)),
    "elf": b"\x7fELF" + bytes(range(256)), "gzip": b"\x1f\x8b\x08" + bytes(range(256)),
    "hdf5": b"\x89HDF\r\n\x1a\n" + bytes(100), "json cut": b'{"body": {"aspect_ratio": 0.',
    "tabs": b"body:\n\taspect_ratio: 1\n", "carriage returns": b"body: {}\rflow: {}\r",
    "bell": b"body: \x07\n", "escape": b"\x1b[2J: 1\n", "deep list": b"[" * 100_000,
    "deep mapping": b"{a: " * 50_000, "deep block": b"- " * 50_000,
    "indentation": b"".join(b" " * n + b"a:\n" for n in range(2000)),
    "quote": b"title: '" + b"x" * 100_000,
    "many keys": b"".join(b"k%d: 1\n" % n for n in range(20_000)),
    "one key many times": b"body: {}\n" * 1000, "long key": b"k" * 100_000 + b": 1\n",
    "very long": b"title: " + b"x" * (9 * 2**20), "bomb": BOMB.encode(),
    "bomb of merges": b"a: &a {x: 1}\nb: {<<: [*a, *a]}\n", "alias cycle": b"a: &a {b: *a}\n",
    "alias as key": b"a: &a x\n*a : 1\n", "unknown alias": b"body: *none\n",
    "mapping as key": b"{{a: 1}: 2}\n", "list as key": b"[1, 2]: 3\n", "null key": b"~: 1\n: 2\n",
    "number key": b"1: 2\n",
    "python object": b"body: !!python/object/apply:os.system ['touch x']\n",
    "python name": b"body: !!python/name:os.system\n", "python module": b"!!python/module:os {}\n",
    "binary tag": b"title: !!binary aGVsbG8=\n", "set": b"body: !!set {a, b}\n",
    "own tag": b"body: !x {}\n", "tag directive": b"%TAG ! tag:python:\n---\nbody: !x {}\n",
    "yaml directive": b"%YAML 9.9\n---\nbody: {}\n",
    "merge key": b"body: {<<: {aspect_ratio: 1}}\n",
    "block scalar": b"body: |\n  aspect_ratio: 1\n", "template": b"body: {{ body }}\n",
    "jinja": b"{% include '/etc/passwd' %}\n", "toml": b"[body]\naspect_ratio = 1\n",
    "xml": b"<?xml version='1.0'?><!DOCTYPE x [<!ENTITY a SYSTEM 'file:///etc/passwd'>]>",
    "python": b"import os\nos.system('touch x')\n", "shell": b"#!/bin/sh\ntouch x\n",
}  # fmt: skip


ODD: dict[str, dict[str, Any]] = {  # what random edits have found
    "paths of a text": {"flow": "9", "sweep": {"axes": [{"flow.trajectory": "all"}]}},
    "paths of a number": {"flow": 3.5, "sweep": {"axes": [{"flow.trajectory": "all"}]}},
    "ragged curvature": {"flow": {"type": "paraboloid", "curvature": [[], 2]}},
    "ragged rotation": {"flow": {"type": "shear", "rotation": [[1, 0], [0], 1]}},
    "ragged quaternion": {"flow": {"type": "shear", "rotation": [[1, 0], 0, 0, 1]}},
    "bodies of a number": {"task": "body", "bodies": 3.5},
    "half a number": {"start": {"position": ["0.2_", "1x", 0]}},
    "paths without number": {
        "flow": {"type": "linear", "gradient": {"process": "gaussian", "end": 9, "paths": {}}},
        "sweep": {"axes": [{"flow.trajectory": "all"}]},
    },
    "no rows of expressions": {"flow": {"type": "linear", "gradient": [["t", 0, 0], 3, [0, 0, 0]]}},
    "no parameters": {"flow": {"type": "user", "function": "case.py:flow", "parameters": 3}},
    "one body within another": {"body": None, "bodies": [{"aspect_ratio": 0.5}] * 2},
    "numbers whose squares are none": {"start": {"position": [1e300, 0, 0]}},
    "no density": {
        "body": {"aspect_ratio": 1, "stokes_number": 1},
        "forces": {"gravity": {"acceleration": 1, "density_ratio": 1e-320}},
    },
    "more samples than disks hold": {"time": {"end": 1, "samples": 1e8}},
    "more values than memory holds": {
        "sweep": {"axes": [{"start.position[0]": {"linspace": [0, 1], "count": 1e11}}]}
    },
    "empty among values": {"sweep": {"axes": [{"body.stokes_number": [0, [], 1]}]}},
    "a body too small": {"body": None, "bodies": [{"aspect_ratio": 1, "size": 1e-300}]},
    "no section beside bodies": {
        "task": "motion",
        "body": None,
        "bodies": [{"aspect_ratio": 1}],
        "surroundings": None,
        "hydrodynamics": "abc",
        "field": {"plane": {"shape": [5, 5], "extent": [5, 6, 5, 6]}},
    },
    "all but massless": {"body": {"aspect_ratio": 1, "stokes_number": 1e-300}},
    "in the wall": {"surroundings": {"type": "wall"}, "time": {"end": 1}},
}


@pytest.mark.parametrize("name", ODD)
def test_odd_values_are_refused(name: str) -> None:
    assert judge(json.dumps(GOOD | ODD[name])).refused


@pytest.mark.parametrize("name", FILES)
def test_files_that_are_no_case(name: str) -> None:
    assert judge(FILES[name]).refused


def test_huge_lists_end_soon() -> None:
    for size in (1000, 100_000, 500_000):
        numbers = ", ".join("1" * size)
        assert judge(f"body: {{aspect_ratio: [{numbers}]}}").refused
        assert judge(json.dumps(GOOD)[:-1] + f', "start": {{"position": [{numbers}]}}}}').refused
    assert judge(json.dumps(with_key("time.at", [float(i) for i in range(200_000, 0, -1)]))).refused


def test_paths_that_are_no_case(tmp_path: Path) -> None:
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    (tmp_path / "dangling").symlink_to(tmp_path / "nowhere")
    os.mkfifo(tmp_path / "fifo")
    (tmp_path / "closed.yaml").write_text(json.dumps(GOOD))
    (tmp_path / "closed.yaml").chmod(0)
    with socket.socket(socket.AF_UNIX) as server:
        server.bind(str(tmp_path / "socket"))
        names = [
            *[tmp_path, "/", ".", "..", "missing.yaml", "missing/case.yaml", tmp_path / "loop"],
            *[tmp_path / "dangling", tmp_path / "fifo", tmp_path / "socket", "/dev/zero"],
            *["/dev/null", "/proc/self/mem", "x" * 5000, "a\nb.yaml", "\x1b[31m", "case.yaml/x"],
            *["\udcff.yaml", "case.yaml\0", "../" * 2000, sys.executable],
        ]
        if os.geteuid():
            names.append(tmp_path / "closed.yaml")
        for name in names:
            for words in (["check", str(name)], [str(name)], [str(name), "--dry-run"]):
                assert command(*words).refused, name


# -- output and other files that a case names ------------------------------------------------


@pytest.mark.parametrize(
    "target",
    [
        *["/nonexistent/folder/x.h5", "missing/x.h5", "..", "/", "", "x.h5/", "case.yaml/x.h5"],
        *["a\nb.h5", "\x1b[2J.h5", "x" * 300 + ".h5", "/dev/null/x.h5"],
    ],
)
def test_impossible_results_are_refused_before_anything_is_computed(target: str) -> None:
    assert judge(json.dumps(with_key("output.file", target))).refused


def test_only_results_are_overwritten(tmp_path: Path) -> None:
    precious = tmp_path / "precious.txt"
    precious.write_text("do not lose me")
    case = with_key("output.file", str(precious))
    Path("case.yaml").write_text(json.dumps(case))
    for words in (["check", "case.yaml"], ["case.yaml", "--dry-run"], ["case.yaml"]):
        outcome = command(*words, "--overwrite")
        assert outcome.refused
        assert "result" in outcome.err
    assert precious.read_text() == "do not lose me"


USER_FLOWS = {
    "no such file": ("missing.py:flow", None),
    "no function named": ("flow.py", "def flow(x, t): return x\n"),
    "no such function": ("flow.py:other", "def flow(x, t): return x\n"),
    "not a function": ("flow.py:flow", "flow = 3\n"),
    "syntax error": ("flow.py:flow", "def flow(x, t) return x\n"),
    "binary": ("flow.py:flow", "\0\0\0"),
    "error on import": ("flow.py:flow", "raise RuntimeError('no\\nway')\n"),
    "exit on import": ("flow.py:flow", "import sys; sys.exit(0)\n"),
    "error when called": ("flow.py:flow", "def flow(x, t): raise ValueError(x)\n"),
    "exit when called": ("flow.py:flow", "def flow(x, t): raise SystemExit(0)\n"),
    "returns nothing": ("flow.py:flow", "def flow(x, t): pass\n"),
    "returns text": ("flow.py:flow", "def flow(x, t): return 'fast'\n"),
    "returns one number": ("flow.py:flow", "def flow(x, t): return 1.0\n"),
    "returns another shape": ("flow.py:flow", "def flow(x, t): return x[..., :2]\n"),
    "returns nan": ("flow.py:flow", "def flow(x, t): return x * float('nan')\n"),
    "returns complex": ("flow.py:flow", "def flow(x, t): return x * 1j\n"),
    "not Stokesian": ("flow.py:flow", "def flow(x, t): return x\n"),
    "wrong arguments": ("flow.py:flow", "def flow(): return 0\n"),
    "outside": ("../../../../../../etc/passwd:root", None),
    "a folder": (".:flow", None),
    "recursion": ("flow.py:flow", "def flow(x, t): return flow(x, t)\n"),
}


@pytest.mark.parametrize("name", USER_FLOWS)
def test_bad_user_flows(name: str, tmp_path: Path) -> None:
    target, source = USER_FLOWS[name]
    if source is not None:
        (tmp_path / "flow.py").write_text(source)
    case = tmp_path / "user.yaml"
    case.write_text(
        json.dumps(GOOD | {"flow": {"type": "user", "function": target}, "time": {"end": 1}})
    )
    outcome = command("check", str(case))
    assert outcome.refused, outcome
    assert outcome.err.startswith(f"{case}:1: flow")


AUDIT = """
import contextlib, io, json, sys
from pathlib import Path
from qbxstokes.__main__ import main

def judge(text):
    Path("bad.yaml").write_bytes(text.encode("latin-1"))
    with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
        main(["check", "bad.yaml", "case.yaml"])

WATCHED = ("exec", "import", "os.system", "subprocess.Popen", "os.exec", "os.fork", "marshal.loads",
           "os.posix_spawn", "socket.connect", "ctypes.dlopen", "pickle.find_class")
watching, seen = False, []

def hook(event, arguments):
    if watching and (event in WATCHED or event == "open" and arguments[1] not in ("r", "rb", None)):
        if "bad.yaml" not in str(arguments[0]):
            seen.append((event, str(arguments)[:200]))

corpus = json.loads(Path("corpus.json").read_text())
for text in corpus:  # what is imported when first needed
    judge(text)
sys.addaudithook(hook)
watching = True
for text in corpus:
    judge(text)
watching = False
print(len(corpus), json.dumps(seen))
"""


def test_loading_runs_no_code(tmp_path: Path) -> None:
    """An audit hook sees every import, exec, process and written file while cases are looked at."""
    corpus = [content.decode("latin-1") for content in FILES.values() if len(content) < 99_999]
    corpus += [
        json.dumps(with_key(key, value))
        for key in ("body.aspect_ratio", "start.position", "output.file", "flow.type", "flow.rate")
        for value in (WRONG["call"], "!!python/name:os.system", "os:system", "/etc/passwd:root")
    ]
    (tmp_path / "corpus.json").write_text(json.dumps(corpus))
    (tmp_path / "case.yaml").write_text(json.dumps(GOOD))
    done = process([sys.executable, "-c", AUDIT], tmp_path)
    assert done.returncode == 0, done.stderr
    assert done.stdout == f"{len(corpus)} []\n"


def process(words: Sequence[str], folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        words,
        cwd=folder,
        env=os.environ | ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


# -- random edits ---------------------------------------------------------------------------

TOKENS = [
    *["null", "true", "-1", "0", "1e300", "-1e-300", ".nan", ".inf", "1e999", "[]", "{}", "''"],
    *[
        "[1, 2, 3]",
        "{a: 1}",
        "abc",
        "pi",
        "1/0",
        "90 deg",
        "&a x",
        "*a",
        "!!int 3",
        "|",
        ">-",
        "- ",
    ],
    *[": ", "\n", "\t", "  ", "#", "'", '"', "{", "}", "[", "]", ",", "---\n", "\0", "é", "\x85"],
]


def edited(text: str, rng: random.Random) -> str:
    """The text with one to three random edits of lines, values or characters."""
    for _ in range(rng.randint(1, 3)):
        lines = text.split("\n")
        at = rng.randrange(len(lines))
        kind = rng.randrange(8)
        if kind == 0:
            del lines[at]
        elif kind == 1:
            lines.insert(at, lines[rng.randrange(len(lines))])
        elif kind == 2:
            lines[at] = " " * rng.randint(0, 6) + lines[at].lstrip()
        elif kind in (3, 4, 5) and ":" in lines[at]:
            head, colon, _ = lines[at].partition(":")
            lines[at] = f"{head}{colon} {rng.choice(TOKENS)}"
        else:
            text = "\n".join(lines)
            start = rng.randrange(len(text) + 1)
            text = text[:start] + rng.choice(TOKENS) + text[start + rng.randint(0, 8) :]
            continue
        text = "\n".join(lines)
    return text


@pytest.mark.parametrize("path", CASES, ids=lambda path: path.stem)
def test_random_edits_of_every_case(path: Path) -> None:
    text = "\n".join(
        line for line in path.read_text().splitlines() if not line.lstrip().startswith("#")
    )
    rng = random.Random(path.stem)
    refused = 0
    for _ in range(60):
        refused += judge(edited(text, rng)).refused
    assert refused > 20


@settings(max_examples=150, deadline=None)
@given(st.binary(max_size=60) | st.text(max_size=60))
def test_arbitrary_content(content: bytes | str) -> None:
    if isinstance(content, str):
        content = content.encode("utf-8", "surrogatepass")
    assert judge(content).refused


VALUES = st.recursive(
    st.none() | st.booleans() | st.floats() | st.integers() | st.text(max_size=6)
    | st.sampled_from([value for value in WRONG.values() if isinstance(value, (str, float))]),
    lambda inner: (
        st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=4), inner, max_size=3)
    ),
    max_leaves=8,
)  # fmt: skip


@settings(max_examples=300, deadline=None)
@given(st.dictionaries(st.sampled_from(list(KEYS)), VALUES, min_size=1, max_size=3))
def test_arbitrary_values_of_known_keys(changes: dict[str, Any]) -> None:
    case = GOOD
    for name, value in changes.items():
        *sections, last = name.split(".")
        case = json.loads(json.dumps(case))
        holder: Any = case
        for section in sections:
            if not isinstance(holder.get(section), dict):
                holder[section] = {}
            holder = holder[section]
        holder[last] = value
    judge(json.dumps(case))


@settings(max_examples=150, deadline=None)
@given(
    st.text(max_size=25)
    | st.tuples(st.sampled_from(list(KEYS)), st.text(max_size=12)).map("=".join)
)
def test_arbitrary_overrides(assignment: str) -> None:
    judge(json.dumps(GOOD), f"--set={assignment}")


WORDS = st.sampled_from(
    [*cli._COMMANDS, "case.yaml", "--set", "--json", "--quiet", "--help", "--nonsense", "-", "--",
     "--dry-run", "--set=x", "--task", "nonsense.h5", "-ts_monitor", "--overwrite", "--table"]
)  # fmt: skip


@settings(max_examples=150, deadline=None)
@given(st.lists(WORDS | st.text(max_size=8), max_size=4))
def test_arbitrary_command_lines(words: list[str]) -> None:
    """Anything may stand on the command line, as long as it does not start a run or write."""
    if "--write" in words or "doctor" in words or "new" in words:
        return
    Path("case.yaml").write_text(json.dumps(GOOD))
    runs = words and words[0] not in cli._COMMANDS
    outcome = command(*words, *(["--dry-run"] if runs else []))
    for line in outcome.err.splitlines() or [""]:  # `check` tells each of several cases
        Outcome(outcome.status, outcome.out, line and line + "\n").check_tidy()


# -- result files ---------------------------------------------------------------------------

READERS = ("info", "plot", "animate")


def result_bytes(folder: Path) -> bytes:
    with ResultWriter(folder / "whole.h5", "motion", {"title": "x"}) as writer:
        writer.append({"time": [0.0, 1.0], "position": [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]})
        return writer.finish({"steps": 1}).read_bytes()


@pytest.mark.parametrize("reader", READERS)
def test_truncated_and_foreign_results_are_refused(reader: str, tmp_path: Path) -> None:
    import h5py

    whole = result_bytes(tmp_path)
    path = tmp_path / "bad.h5"
    for length in [*range(0, 600, 37), *range(600, len(whole), len(whole) // 25), len(whole) - 1]:
        path.write_bytes(whole[:length])
        assert command(reader, str(path)).refused, length
    for name, content in FILES.items():
        path.write_bytes(content)
        assert command(reader, str(path)).refused, name
    path.write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(4096))
    assert command(reader, str(path)).refused
    for attributes in (
        {},
        {"format": "other", "task": "motion"},
        {"format": "qbxstokes"},
        {"format": "qbxstokes", "task": "motion", "format_version": 99},
        {"format": "qbxstokes", "task": "motion", "format_version": "one"},
        {"format": "qbxstokes", "task": "motion", "format_version": 1},
        {"format": [1, 2], "task": 3},
    ):
        with h5py.File(path, "w") as file:
            file.attrs.update(attributes)
            file["time"] = [0.0]
        assert command(reader, str(path)).refused, attributes
    os.mkfifo(tmp_path / "fifo")
    for name in (tmp_path, tmp_path / "missing.h5", "/dev/zero", "/dev/null", tmp_path / "fifo"):
        assert command(reader, str(name)).refused, name


FLIPS = """
import random, sys
from pathlib import Path
from qbxstokes.errors import ResultFileError
from qbxstokes.io.results import load
whole, rng = Path("whole.h5").read_bytes(), random.Random(7)
assert b"GCOL" in whole  # texts: HDF5 keeps no checksum of them and trusts their lengths
refused = 0
for _ in range(400):
    damaged = bytearray(whole)
    for _ in range(rng.choice([1, 1, 4, 64])):
        damaged[rng.randrange(len(whole))] = rng.randrange(256)
    if rng.random() < 0.5:
        at, size = rng.randrange(len(whole)), rng.choice([8, 64, 512, 4096])
        damaged[at : at + size] = bytes(len(damaged[at : at + size]))
    Path("bad.h5").write_bytes(damaged)
    try:
        load("bad.h5")
    except ResultFileError as error:
        assert str(error).isprintable(), repr(str(error))
        refused += 1
print(refused)
"""


def test_damaged_results_are_refused_or_whole(tmp_path: Path) -> None:
    result_bytes(tmp_path)
    done = process([sys.executable, "-c", FLIPS], tmp_path)
    assert done.returncode == 0, done.stderr
    assert int(done.stdout) > 20


# -- runs -----------------------------------------------------------------------------------

EXTREMES: dict[str, dict[str, Any]] = {
    "fast shear": {"flow": {"type": "shear", "rate": 1e300}},
    "slow shear": {"flow": {"type": "shear", "rate": 1e-300}},
    "far away": {"start": {"position": [1e300, 1e300, 1e300]}},
    "curved far away": {"flow": {"type": "paraboloid"}, "start": {"position": [0, 1e200, 0]}},
    "needle": {"body": {"aspect_ratio": 1e-6}},
    "disc": {"body": {"aspect_ratio": 1e6}},
    "heavy": {"body": {"aspect_ratio": 0.5, "stokes_number": 1e300}},
    "light": {"body": {"aspect_ratio": 0.5, "stokes_number": 1e-300}},
    "tiny tolerance": {"hydrodynamics": {"tolerance": 1e-300}},
    "one instant": {"time": {"at": [1e-300]}},
}


@pytest.mark.parametrize("name", EXTREMES)
def test_extreme_runs_end_with_a_result_or_a_line(name: str) -> None:
    """Status 0 with a result; or status 1 or 2 with one line, and a file only if it says so."""
    case = GOOD | {"time": {"end": 1, "samples": 3}} | EXTREMES[name]
    Path("case.yaml").write_text(json.dumps(case))
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        status = main(["case.yaml", "--quiet"])
    result = Path("case.h5")
    if status == 0:
        assert err.getvalue() == ""
        result.unlink()
    else:
        assert status in (1, 2)
        assert err.getvalue().count("\n") == 1, err.getvalue()
        assert result.exists() == ("case.h5 holds the motion so far" in err.getvalue())
        result.unlink(missing_ok=True)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        ("body: {aspect_ratio: -1}\n", []),
        ("body: {aspect_ratio: 1}\nflow: {type: sheer}\ntime: {end: 1}\n", []),
        ("\x1b", []),
        (json.dumps(GOOD), ["--nonsense"]),
        (json.dumps(GOOD), ["--set", "body.aspect_ratio=0"]),
        (json.dumps(GOOD), ["--set", "output.file=/nonexistent/x.h5"]),
    ],
)
def test_a_real_process(
    content: str, words: list[str], run_process: Callable[..., Any], tmp_path: Path
) -> None:
    (tmp_path / "case.yaml").write_text(content)
    done = run_process("case.yaml", *words)
    Outcome(done.returncode, done.stdout, done.stderr).check_tidy()
    assert done.returncode == 2
    assert [file.name for file in tmp_path.iterdir()] == ["case.yaml"]


@pytest.mark.mpi
def test_two_ranks_tell_once(mpirun: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "case.yaml").write_text(json.dumps(GOOD | {"body": {"aspect_ratio": -1}}))
    done = mpirun(2, "case.yaml")
    assert done.returncode == 2
    assert done.stderr.count("aspect_ratio: is -1") == 1
    assert "Traceback" not in done.stderr
